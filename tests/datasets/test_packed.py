from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fploc.datasets.packed import PackedSite, packed_sites, read_packed
from fploc.errors import BadFileError, HashMismatchError, MissingFileError
from fploc.schema import TABLES
from fploc.sites.registry import known_sites

LOCAL = [name for name in known_sites() if name not in ("canteen", "carpark")]


@pytest.fixture
def library(data_root: Path, tmp_path: Path) -> Path:
    """A data root whose library may be spoilt."""
    shutil.copytree(data_root / "packed" / "library", tmp_path / "packed" / "library")
    return tmp_path


@pytest.mark.parametrize("name", LOCAL)
def test_tables_plan_and_arrays_fit_together(data_root: Path, name: str) -> None:
    packed = read_packed(data_root, name)
    assert packed.site.name == packed.plan.name == name
    readings, intervals = packed.readings, packed.intervals
    keys = ["device", "recording", "interval"]
    assert readings[keys].drop_duplicates().merge(intervals[keys]).shape[0] == len(
        readings[keys].drop_duplicates()
    )
    assert set(readings["mac"]) == set(packed.site.macs)
    slant, plan = readings["range_slant_m"], readings["range_plan_m"]
    projected = plan[plan > 0]
    np.testing.assert_allclose(slant[projected.index] ** 2, projected**2 + 0.25)
    totals = packed.manifest["totals"]
    assert sum(total["intervals"] for total in totals.values()) == len(intervals)
    assert sum(total["readings_kept"] for total in totals.values()) == len(readings)
    recordings = packed.recordings()
    assert len(recordings) == sum(total["recordings"] for total in totals.values())
    assert sum(int(recording.heard.sum()) for recording in recordings) == int(slant.notna().sum())
    for recording in recordings:
        assert recording.t_s[0] == 0 and (np.diff(recording.t_s) >= 0).all()
    inside = packed.plan.georeference.to_pixels(packed.site.positions_m)
    assert (inside >= 0).all() and (inside < packed.plan.grey.shape[::-1]).all()


def test_readable_with_pandas_alone(data_root: Path) -> None:
    folder = data_root / "packed" / "laboratory"
    for table in TABLES:
        frame = pd.read_parquet(folder / f"{table.name}.parquet")
        assert list(frame.columns) == [column.name for column in table.columns] and len(frame) > 1000
    site = json.loads((folder / "site.json").read_text())
    assert site["access_points"][2]["mac"] == "b0:e4:d5:96:3b:95"
    assert len(site["plan"]["pixels_from_metres"]) == 2 and site["faults"]


def test_missing_site_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="`fploc data build`"):
        read_packed(tmp_path, "library")


def test_packed_sites_are_listed_by_name_and_folders_of_other_things_are_not(tmp_path: Path) -> None:
    for name in ("mall", "attic"):
        (tmp_path / "packed" / name).mkdir(parents=True)
        (tmp_path / "packed" / name / "manifest.json").write_text("{}")
    (tmp_path / "packed" / "half-built").mkdir()
    assert packed_sites(tmp_path) == ["attic", "mall"]
    with pytest.raises(MissingFileError, match=r"packed sites.*`fploc data build`"):
        packed_sites(tmp_path / "packed")


@pytest.mark.parametrize("name", ["readings.parquet", "splits.json", "plan.png"])
def test_changed_or_missing_file_is_refused(library: Path, name: str) -> None:
    path = library / "packed" / "library" / name
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(HashMismatchError, match=f"{name} \\(SHA-256\\)"):
        read_packed(library, "library")
    path.unlink()
    with pytest.raises(MissingFileError, match=name):
        read_packed(library, "library")


def test_other_schema_version_is_refused(library: Path) -> None:
    path = library / "packed" / "library" / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps(manifest | {"schema_version": 0}))
    with pytest.raises(BadFileError, match="schema_version: found 0, expected 1; rebuild"):
        read_packed(library, "library")


@pytest.mark.parametrize("text", ["{", "[]", "{}"])
def test_unreadable_manifest_is_refused(library: Path, text: str) -> None:
    (library / "packed" / "library" / "manifest.json").write_text(text)
    with pytest.raises(BadFileError, match=r"manifest\.json, whole file"):
        read_packed(library, "library")


def test_hash_stands_for_the_data(data_root: Path, library: Path) -> None:
    def hash_of(packed: PackedSite) -> str:
        return packed.manifest_hash

    first = hash_of(read_packed(data_root, "library"))
    assert first == hash_of(read_packed(library, "library")) != hash_of(read_packed(data_root, "office"))
