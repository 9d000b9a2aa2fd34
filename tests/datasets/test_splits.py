from __future__ import annotations

import json
from pathlib import Path

import pytest

from fploc.datasets.packed import read_packed
from fploc.datasets.splits import make_splits, splits_from_json, splits_to_json
from fploc.errors import UnknownNameError
from fploc.sites.registry import known_sites, load_spec


def test_office_laps_split_by_recording() -> None:
    splits = make_splits(load_spec("office").recordings)
    assert splits.train == ((1, "lab1"), (1, "lab2"), (1, "lab4"))
    assert splits.validate == ((1, "lab3"),)
    assert splits.test == ((1, "lab5"),)


@pytest.mark.parametrize("name", [name for name in known_sites() if name != "office"])
def test_all_other_sites_are_for_testing(name: str) -> None:
    spec = load_spec(name)
    splits = make_splits(spec.recordings)
    assert splits.train == splits.validate == ()
    assert splits.test == tuple((recording.device, recording.name) for recording in spec.recordings)


def test_splits_survive_their_file(data_root: Path) -> None:
    packed = read_packed(data_root, "office")
    assert packed.splits == make_splits(load_spec("office").recordings)
    assert splits_from_json(json.loads(json.dumps(splits_to_json(packed.splits)))) == packed.splits
    every = [key for part in ("train", "validate", "test") for key in packed.splits.part(part)]
    assert sorted(every) == [(recording.device, recording.name) for recording in packed.recordings()]


def test_unknown_part_is_named() -> None:
    with pytest.raises(UnknownNameError, match="'dev', expected one of train, validate, test"):
        make_splits([]).part("dev")
