"""Every file of the two pinned revisions of the public data set, with its git blob SHA-1.

The lists in ``files/*.tsv`` were read from the repository's git trees.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from fploc.errors import MissingFileError, UnknownNameError
from fploc.sites.registry import FileRef, SiteSpec, known_sites, load_spec

REPOSITORY = "https://github.com/haiyaoyu/RTT-Indoor-localization-data-set"

# Folder name in a source -> full hash of the commit.
REVISIONS = {
    "2b19c6c": "2b19c6c0db0e54f07800802fdf261ea3835ca478",
    "0bdeb2a": "0bdeb2a5252b08490e3c19ebcbabd640aaa48a02",
}

_EXAMPLE = "2b19c6c/raw_data/Laboratory/1/113.csv"


@dataclass(frozen=True)
class SourceFile:
    """One file of the public data set.

    Args:
        revision: Short hash, the name of its folder in a source.
        path: Path in the repository, with forward slashes.
        blob_sha1: Git blob SHA-1 of its contents.
        size: In bytes; None where the list does not hold it.
    """

    revision: str
    path: str
    blob_sha1: str
    size: int | None

    @property
    def name(self) -> str:
        """``<revision>/<path>``, as users see it."""
        return f"{self.revision}/{self.path}"

    def below(self, source: Path) -> Path:
        """Where the file stands in the folder ``source``."""
        return source / self.revision / self.path


def blob_sha1(contents: bytes) -> str:
    """Return the hash that git gives a file: SHA-1 over a header with the size, then the contents."""
    return hashlib.sha1(b"blob %d\0" % len(contents) + contents, usedforsecurity=False).hexdigest()


@cache
def listed_files() -> dict[str, SourceFile]:
    """Return every file of both revisions by its name ``<revision>/<path>``."""
    files = (file for revision in REVISIONS for file in _read_list(revision))
    return {file.name: file for file in files}


def listed_file(revision: str, path: str) -> SourceFile:
    """Return one file of the lists.

    Raises:
        UnknownNameError: If the revision holds no such file.
    """
    name = f"{revision}/{path}"
    files = listed_files()
    if name not in files:
        raise UnknownNameError(
            "file of the public data set",
            name,
            known=[f"the {len(files)} files in fploc/datasets/files/*.tsv"],
            way_out="correct the path in the site's registry file",
        )
    return files[name]


def required_files(spec: SiteSpec) -> tuple[FileRef, ...]:
    """Return the files without which a site cannot be built: plan, recordings and device links."""
    return tuple(file for file in spec.files if file != spec.long_table)


def site_files(sites: Sequence[str]) -> list[SourceFile]:
    """Return every public file that ``sites`` can use, each once: AP lists and long tables included.

    Raises:
        UnknownNameError: If a site is unknown, or its registry names a file that no pinned revision holds.
    """
    specs = [load_spec(site) for site in sites]
    references = dict.fromkeys(file for spec in specs for file in (*spec.files, *spec.sheets))
    return [listed_file(file.revision, file.path) for file in references if file.revision is not None]


def split_by_presence(source: Path, sites: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the sites of which ``source`` holds at least one recording, and those of which it holds none."""
    present: list[str] = []
    absent: list[str] = []
    for site in sites:
        spec = load_spec(site)
        files = (spec.locate(file, source) for recording in spec.recordings for file in recording.files)
        (present if any(path.is_file() for path in files) else absent).append(site)
    return present, absent


def require_usable(source: Path, *, named_by: str) -> Path:
    """Return the folder ``source``, which the option or variable ``named_by`` names, where it is a source.

    Raises:
        MissingFileError: If it holds no revision of the data set, or no recording of any site.
    """
    way_out = f"correct {named_by}, or leave it out to download from GitHub"
    if not any(folder.is_dir() for revision in REVISIONS for folder in source.glob(f"{revision}*")):
        raise MissingFileError(
            f"{source} ({named_by})",
            expected=f"a folder laid out <revision>/<path>, with {' or '.join(REVISIONS)} in it",
            way_out=way_out,
        )
    present, _ = split_by_presence(source, known_sites())
    if not present:
        raise MissingFileError(
            f"{source} ({named_by})",
            expected=f"recordings of at least one site, for example {_EXAMPLE}",
            way_out=way_out,
        )
    return source


def _read_list(revision: str) -> list[SourceFile]:
    text = resources.files("fploc.datasets").joinpath("files", f"{revision}.tsv").read_text("utf-8")
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    # csv's own quoting would break on a path that holds a quote.
    rows = csv.DictReader(lines, delimiter="\t", quoting=csv.QUOTE_NONE)
    return [
        SourceFile(
            revision=revision,
            path=row["path"],
            blob_sha1=row["blob_sha1"],
            size=None if row["bytes"] == "-" else int(row["bytes"]),
        )
        for row in rows
    ]
