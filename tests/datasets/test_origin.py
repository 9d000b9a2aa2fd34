from __future__ import annotations

import pytest

from fploc.datasets.origin import CITATION, MADE_UP, OWN, PUBLIC, Origin, origin_of, public_licence
from fploc.datasets.source_files import REVISIONS, blob_sha1, listed_file


@pytest.mark.parametrize(
    ("made_up", "paths", "expected"),
    [
        (False, ["2b19c6c/raw_data/a.csv", "0bdeb2a/plan.jpg"], PUBLIC),
        (False, ["2b19c6c/raw_data/a.csv", "laps/1.csv"], OWN),
        (True, ["1/1_3_10_00_00.csv"], MADE_UP),
    ],
    ids=["public", "own", "made-up"],
)
def test_an_origin_is_known_by_its_sources(made_up: bool, paths: list[str], expected: Origin) -> None:
    manifest = {"made_up": made_up, "sources": [{"path": path} for path in paths]}
    assert origin_of(manifest) == expected


@pytest.mark.parametrize("revision", REVISIONS)
def test_the_licence_is_the_authors_own_file(revision: str) -> None:
    text = public_licence()
    assert blob_sha1(text.encode()) == listed_file(revision, "LICENSE").blob_sha1
    assert "Copyright (c) 2022 haiyaoyu" in text


def test_terms_are_stated_only_where_they_are_known() -> None:
    assert PUBLIC.citation == CITATION and PUBLIC.licence_url == "https://spdx.org/licenses/MIT.html"
    assert (OWN.licence, OWN.licence_url, OWN.citation, MADE_UP.citation) == (None, None, None, None)
