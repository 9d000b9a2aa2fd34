"""What there is to learn from and to test on, of sites that are packed already."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fploc.datasets.packed import packed_folder
from fploc.errors import MissingFileError
from fploc.experiments.world import World, packed_world
from fploc.schema import SCHEMA_VERSION


def pack(root: Path, name: str, *, made_up: bool) -> None:
    """Leave behind what tells a packed site from a folder."""
    folder = packed_folder(root, name)
    folder.mkdir(parents=True)
    manifest = {"schema_version": SCHEMA_VERSION, "files": {}, "made_up": made_up}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_public_sites_come_without_the_made_up_ones_beside_them(tmp_path: Path) -> None:
    for name, made_up in {"laboratory": False, "made-up-1": True, "office": False}.items():
        pack(tmp_path, name, made_up=made_up)
    assert packed_world(tmp_path) == World("office", ("laboratory",), made_up=False)


def test_made_up_buildings_stand_in_where_the_public_source_is_not_there(tmp_path: Path) -> None:
    for name, made_up in {"made-up-2": True, "laboratory": False, "made-up-1": True}.items():
        pack(tmp_path, name, made_up=made_up)
    assert packed_world(tmp_path) == World("made-up-1", ("made-up-2",), made_up=True)


def test_without_a_source_the_command_that_packs_it_is_named(tmp_path: Path) -> None:
    pack(tmp_path, "laboratory", made_up=False)
    with pytest.raises(MissingFileError, match=r"office.*fploc data build"):
        packed_world(tmp_path)


def test_nothing_packed_is_told_as_well(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="fploc data build"):
        packed_world(tmp_path)
