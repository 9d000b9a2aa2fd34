from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fploc.errors import BadFileError, MissingFileError, UnknownNameError
from fploc.sites.registry import load_spec

SITE = {
    "name": "attic",
    "device_height_m": 1.0,
    "access_points": [
        {"name": "AP1", "mac": "b0:e4:d5:39:26:89", "x_m": 0.0, "y_m": 0, "height_m": 1.5},
        {"name": "AP2", "mac": "cc:f4:11:8b:29:4d", "x_m": 5.0, "y_m": 0, "height_m": 2.0},
    ],
    "plan": {
        "file": {"path": "plan.png"},
        "native_from_metres": [[10, 0, 0], [0, -10, 100]],
        "origin_m": [0, 10],
        "size_px": [200, 200],
        "estimated_error_m": 0.1,
    },
    "recordings": [{"device": 1, "name": "113", "lap": "1", "raw": {"path": "1/log.csv"}}],
}


def write(folder: Path, **changes: object) -> Path:
    path = folder / "attic.yaml"
    path.write_text(yaml.safe_dump(SITE | changes, sort_keys=False))
    return path


def test_users_own_site_file_takes_files_beside_it(tmp_path: Path) -> None:
    spec = load_spec(write(tmp_path))
    assert spec.site.place == "attic" and not spec.site.made_up
    assert spec.site.height_differences_m.tolist() == [0.5, 1.0]
    assert spec.locate(spec.plan.file, None) == tmp_path / "plan.png"
    assert spec.recordings[0].split == "test" and spec.numbering == "auto"


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"colour": "red"}, "colour"),
        ({"device_height_m": "one"}, "device_height_m"),
        ({"device_height_m": float("nan")}, "device_height_m"),
        ({"name": 7}, "name"),
        ({"numbering": "backwards"}, "numbering"),
        ({"access_points": []}, "access_points"),
        ({"access_points": [SITE["access_points"][0]] * 2}, "access_points"),
        ({"access_points": [{**SITE["access_points"][0], "mac": "B0-E4"}]}, r"access_points\[0\].mac"),
        ({"plan": {**SITE["plan"], "native_from_metres": [[1, 2, 0], [2, 4, 0]]}}, "plan.native_from_metres"),
        ({"plan": {**SITE["plan"], "native_from_metres": [[1, 2], [2, 4]]}}, "plan.native_from_metres"),
        ({"plan": {**SITE["plan"], "native_from_metres": [[1, 0, 0]]}}, "plan.native_from_metres"),
        ({"plan": {**SITE["plan"], "size_px": [0, 10]}}, "plan.size_px"),
        ({"plan": {**SITE["plan"], "metres_per_pixel": 0.0}}, "plan.metres_per_pixel"),
        ({"plan": {**SITE["plan"], "not_walls_m": [[[0, 0], [1, 1]]]}}, "plan.not_walls_m"),
        ({"plan": {**SITE["plan"], "file": {"path": "p", "revision": "abc"}}}, "plan.file.blob_sha1"),
        ({"recordings": [{**SITE["recordings"][0], "device": 3}]}, r"recordings\[0\].device"),
        ({"recordings": [{**SITE["recordings"][0], "repairs": ["magic"]}]}, r"recordings\[0\].repairs"),
        ({"recordings": [{**SITE["recordings"][0], "repairs": [1]}]}, r"recordings\[0\].repairs"),
        ({"recordings": SITE["recordings"] * 2}, "recordings"),
        ({"recordings": [{"device": 1, "name": "113", "lap": "1"}]}, r"recordings\[0\].cleaned"),
        ({"true_distance_faults": ["AP9"]}, "true_distance_faults"),
    ],
)
def test_wrong_key_is_named_with_its_file(tmp_path: Path, changes: dict[str, object], key: str) -> None:
    with pytest.raises(BadFileError, match=rf"attic.yaml, key {key}"):
        load_spec(write(tmp_path, **changes))


def test_missing_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "attic.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in SITE.items() if key != "plan"}))
    with pytest.raises(BadFileError, match="key plan: found 'nothing'"):
        load_spec(path)


def test_key_given_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "attic.yaml"
    path.write_text("name: a\nname: b\n")
    with pytest.raises(BadFileError, match="name stands twice"):
        load_spec(path)


@pytest.mark.parametrize("text", ["- 1\n- 2\n", "a: [1\n", ""])
def test_file_that_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "attic.yaml"
    path.write_text(text)
    with pytest.raises(BadFileError, match="whole file"):
        load_spec(path)


def test_unknown_and_missing_sites() -> None:
    with pytest.raises(UnknownNameError, match="'moon', expected one of office, "):
        load_spec("moon")
    with pytest.raises(MissingFileError):
        load_spec("nowhere/site.yaml")


def test_source_may_use_full_commit_hashes(tmp_path: Path) -> None:
    (tmp_path / "2b19c6c0db0e54f07800802fdf261ea3835ca478").mkdir()
    spec = load_spec("library")
    found = spec.locate(spec.recordings[0].files[0], tmp_path)
    assert found.relative_to(tmp_path).parts[0] == "2b19c6c0db0e54f07800802fdf261ea3835ca478"


def test_public_site_needs_a_source() -> None:
    spec = load_spec("library")
    with pytest.raises(MissingFileError, match="--from DIR"):
        spec.locate(spec.plan.file, None)
