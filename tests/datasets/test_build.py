from __future__ import annotations

import errno
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fploc.datasets import build
from fploc.datasets.build import build_sites
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.published import join_published
from fploc.errors import BadFileError, FplocError, HashMismatchError, MissingFileError
from fploc.raw.cleaned import read_cleaned
from fploc.raw.long_table import read_long_table
from fploc.raw.phone_log import read_phone_log
from fploc.sites.made_up import made_up_site
from fploc.sites.registry import load_spec

# The facts of the public files: rows, intervals and readings kept of each site and device.
COUNTS = {
    ("office", "device1"): (5, 19_420, 19_357, 144_694),
    ("office-position1", "device1"): (5, 15_196, 15_196, 114_193),
    ("office-position2", "device1"): (5, 15_013, 15_013, 114_199),
    ("conference-room", "device1"): (5, 7_019, 4_270, 28_750),
    ("conference-room", "device2"): (5, 4_794, 2_407, 10_152),
    ("laboratory", "device1"): (5, 6_577, 6_577, 38_277),
    ("laboratory", "device2"): (5, 3_803, 3_800, 20_034),
    ("library", "device1"): (4, 2_634, 2_634, 15_304),
    ("library", "device2"): (4, 4_820, 4_820, 28_063),
    ("shopping-mall", "device1"): (4, 9_296, 8_437, 50_466),
    ("shopping-mall", "device2"): (4, 3_541, 3_306, 10_904),
}


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A made-up building: a user's own site, whose files may be spoilt."""
    return made_up_site(5, tmp_path / "building", laps=1, duration_s=20.0)


@pytest.mark.parametrize(("site", "device"), COUNTS)
def test_counts_of_the_public_sites(data_root: Path, site: str, device: str) -> None:
    total = read_packed(data_root, site).manifest["totals"][device]
    found = tuple(total[key] for key in ("recordings", "rows", "intervals", "readings_kept"))
    assert found == COUNTS[site, device]


def test_office_of_2022_is_as_large_as_published(data_root: Path) -> None:
    total = read_packed(data_root, "office").manifest["totals"]["device1"]
    assert total["rows"] == 19_420 and total["readings_in_file"] == 145_144


@pytest.mark.parametrize("site", sorted({site for site, _ in COUNTS}))
def test_every_reading_is_kept_or_counted(data_root: Path, site: str) -> None:
    for counts in read_packed(data_root, site).manifest["recordings"]:
        assert counts["rows"] - sum(counts["dropped_sets"].values()) == counts["intervals"]
        dropped = sum(counts["dropped_readings"].values())
        assert counts["readings_in_file"] - dropped == counts["readings_kept"], counts["recording"]


def test_true_distances_confirm_the_access_points_by_mac(data_root: Path) -> None:
    """In every cleaned lap each AP's columns hold distances to its coordinates in the registry."""
    checked = 0
    for site in sorted({site for site, _ in COUNTS}):
        for counts in read_packed(data_root, site).manifest["recordings"]:
            assert all(off < 0.01 for off in counts["true_distance_m"].values()), counts
            checked += len(counts["true_distance_m"])
    assert checked > 250


def test_row_grids_are_rescaled_to_the_raw_log(data_root: Path) -> None:
    rescaled = {
        counts["recording"]
        for site in ("conference-room", "shopping-mall", "laboratory", "library", "office")
        for counts in read_packed(data_root, site).manifest["recordings"]
        if "rescaled" in counts["clock"]
    }
    assert rescaled == {"124", "213", "524", "713", "1113"}
    mall = read_packed(data_root, "shopping-mall").intervals
    assert mall[mall["recording"] == "713"]["t_ms"].max() == pytest.approx(700_686, abs=400)


def test_sites_that_the_source_lacks_are_listed(source: Path, tmp_path: Path) -> None:
    reports = build_sites(source, tmp_path, ["canteen", "carpark"])
    assert [report.state for report in reports] == ["absent", "absent"]
    assert all(not report.folder.exists() and report.missing for report in reports)


def test_partial_source_builds_what_is_there(source: Path, tmp_path: Path) -> None:
    spec = load_spec("library")
    partial = tmp_path / "source"
    kept = [spec.plan.file, *spec.recordings[1].files, spec.links[0].file]
    for file in kept:
        assert file.revision is not None
        (partial / file.revision / file.path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(spec.locate(file, source), partial / file.revision / file.path)
    (report,) = build_sites(partial, tmp_path / "data", ["library"])
    packed = read_packed(tmp_path / "data", "library")
    assert report.state == "built" and len(report.missing) == len(spec.files) - len(kept)
    assert [recording.name for recording in packed.recordings()] == ["413"]
    assert packed.manifest["missing"] == list(report.missing) and packed.splits.test == ((1, "413"),)

    (partial / "0bdeb2a" / spec.plan.file.path).unlink()
    with pytest.raises(MissingFileError, match="floor plan of library"):
        build_sites(partial, tmp_path / "data", ["library"])
    assert read_packed(tmp_path / "data", "library").manifest_hash == packed.manifest_hash


def test_wrong_hash_names_both(source: Path, tmp_path: Path) -> None:
    spec = load_spec("library")
    path = tmp_path / "2b19c6c" / spec.recordings[0].files[0].path
    path.parent.mkdir(parents=True)
    path.write_bytes(spec.locate(spec.recordings[0].files[0], source).read_bytes()[:-1])
    with pytest.raises(
        HashMismatchError, match=r"213\.csv \(git blob SHA-1\): found [0-9a-f]{40}, expected 6537ded"
    ):
        build_sites(tmp_path, tmp_path / "data", ["library"])
    assert not (tmp_path / "data" / "packed" / "library").exists()


def test_held_out_site_builds_from_the_registry_alone(tmp_path: Path, source: Path) -> None:
    """Files of the car park's kinds with made-up numbers in its own folders; AP2's true distance wrong."""
    spec = load_spec("carpark")
    recording = spec.recordings[0]
    steps = np.arange(40)
    x_m = 1.0 + 0.05 * np.repeat(np.arange(20), 2)
    columns: dict[str, object] = {"M1 Time Stamp (ms)": 200 * steps}
    for number, (ap_x, ap_y) in enumerate(spec.site.positions_m, start=1):
        distance = np.hypot(x_m - ap_x, 2.0 - ap_y)
        columns[f"AP{number} True Distance (m)"] = distance + (2.0 if number == 2 else 0.0)
        columns[f"AP{number} RTT Distance (m)"] = distance + 2.0
        columns[f"AP{number} RTT std (m)"] = 0.1
        columns[f"AP{number} RSS (dBm)"] = -60
    imu = [
        "AccX",
        "AccY",
        "AccZ",
        "GyroX",
        "GyroY",
        "GyroZ",
        "MagX",
        "MagY",
        "MagZ",
        "Azimuth",
        "Pitch",
        "Roll",
    ]
    columns |= dict.fromkeys(imu, 0.0) | {"M1 Ground Truth": [f"[{x}, 2.0]" for x in x_m]}
    copy = tmp_path / "source"
    for file in recording.files:
        (copy / "2b19c6c" / file.path).parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(columns).to_csv(copy / "2b19c6c" / recording.files[0].path, index=False)
    result = "[" + ", ".join(f"{mac}, 5000, 100, -60" for mac in spec.site.macs) + "]"
    raw_imu = [
        "Accx",
        "Accy",
        "Accz",
        "Gyrox",
        "Gyroy",
        "Gyroz",
        "Magx",
        "Magy",
        "Magz",
        "Azimuth",
        "Pitch",
        "Roll",
    ]
    log = {"Number": steps, "RTT_TIMESTAMP": 0, "RTT_RESULT": result, "IMU_TIMESTAMP": 210e6 * steps + 1e12}
    pd.DataFrame(log | dict.fromkeys(raw_imu, 0.0)).to_csv(
        copy / "2b19c6c" / recording.files[1].path, index=False
    )
    plan = copy / "0bdeb2a" / spec.plan.file.path
    plan.parent.mkdir(parents=True)
    shutil.copy(spec.locate(spec.plan.file, source), plan)

    registry = tmp_path / "carpark.yaml"
    text = spec.path.read_text(encoding="utf-8")
    for file in recording.files:
        contents = (copy / "2b19c6c" / file.path).read_bytes()
        text = text.replace(str(file.blob_sha1), build.blob_sha1(contents))
    registry.write_text(text, encoding="utf-8")
    (report,) = build_sites(copy, tmp_path / "data", [registry])
    assert report.state == "built" and len(report.missing) == 8
    packed = read_packed(tmp_path / "data", "carpark")
    (lap,) = packed.recordings()
    assert lap.name == "513" and len(lap) == 20
    np.testing.assert_allclose(np.diff(lap.t_s), 0.42)
    offset = lap.published_m[:, None] - packed.site.positions_m
    np.testing.assert_allclose(np.sqrt(lap.slant_m**2 - 0.25), np.linalg.norm(offset, axis=2) + 2.0)


def test_columns_of_another_access_point_are_refused(source: Path, tmp_path: Path) -> None:
    """A site file that swaps two access points contradicts the true distances of the laps."""
    text = load_spec("library").path.read_text(encoding="utf-8")
    swapped = text.replace("x_m: 11.55, y_m: 0,", "X").replace("x_m: 23.835, y_m: 0,", "x_m: 11.55, y_m: 0,")
    path = tmp_path / "library.yaml"
    path.write_text(swapped.replace("X", "x_m: 23.835, y_m: 0,"), encoding="utf-8")
    with pytest.raises(BadFileError, match=r"213\.csv, column True Distance of AP1: found distances to AP5"):
        build_sites(source, tmp_path / "data", [path])


def test_second_build_changes_nothing_until_something_changes(own: Path, tmp_path: Path) -> None:
    def state() -> str:
        return build_sites(None, tmp_path / "data", [own])[0].state

    assert [state(), state()] == ["built", "unchanged"]
    folder = tmp_path / "data" / "packed" / "made-up-5"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    own.write_text(own.read_text() + "\n# another comment\n")
    assert [state(), state()] == ["built", "unchanged"]
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert before.keys() == after.keys() and "croissant.json" in after
    assert before["readings.parquet"] == after["readings.parquet"]
    (folder / "walls.png").unlink()
    assert state() == "built"


def test_made_up_building_says_so(own: Path, tmp_path: Path) -> None:
    build_sites(None, tmp_path, [own])
    packed = read_packed(tmp_path, "made-up-5")
    assert packed.site.made_up and packed.manifest["made_up"] and packed.info["made_up"]
    assert len(packed.device_links) > 0 and not packed.intervals["x_published_m"].isna().any()


@pytest.fixture
def packed_before(own: Path, tmp_path: Path) -> Iterator[PackedSite]:
    """A packed site that a failing build must leave as it was, and nothing beside it."""
    build_sites(None, tmp_path, [own])
    before = read_packed(tmp_path, "made-up-5")
    yield before
    assert read_packed(tmp_path, "made-up-5").manifest_hash == before.manifest_hash
    assert [path.name for path in (tmp_path / "packed").iterdir()] == ["made-up-5"]


def test_bad_log_leaves_what_was_there(own: Path, tmp_path: Path, packed_before: PackedSite) -> None:
    log = own.parent / str(load_spec(own).recordings[0].files[0].path)
    log.write_text(log.read_text()[:-100])
    with pytest.raises(BadFileError, match=f"{log.name}, "):
        build_sites(None, tmp_path, [own])


def test_full_disk_leaves_what_was_there(
    own: Path, tmp_path: Path, packed_before: PackedSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_text(*_: object, **__: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    own.write_text(own.read_text() + "\n")
    monkeypatch.setattr(Path, "write_text", write_text)
    with pytest.raises(
        FplocError, match=r"No space left on device, expected a folder with room.*--data-root"
    ):
        build_sites(None, tmp_path, [own])


def test_limit_on_file_size_ends_in_one_line(own: Path, tmp_path: Path, unmeasured: dict[str, str]) -> None:
    """The real thing: the kernel refuses to write beyond a few kilobytes."""
    script = (
        "import resource, sys; from pathlib import Path\n"
        "from fploc.datasets.build import build_sites; from fploc.errors import FplocError\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, (4096, {resource.RLIM_INFINITY}))\n"
        f"try: build_sites(None, Path({str(tmp_path / 'data')!r}), [{str(own)!r}])\n"
        "except FplocError as error: sys.exit(str(error))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=unmeasured, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1 and "room to write" in done.stderr
    assert not list((tmp_path / "data" / "packed").iterdir())


def test_long_table_gives_labels_to_a_raw_log(source: Path) -> None:
    """On library laps, where the cleaned lap knows the labels: the join finds them within 5 cm."""
    spec = load_spec("library")
    table = read_long_table(source / "2b19c6c" / "clean_data" / "dataset_Library.csv")
    for recording in spec.recordings[:4]:
        lap = read_phone_log(spec.locate(recording.files[1], source), spec.site)
        truth = read_cleaned(spec.locate(recording.files[0], source), spec.site).sets[["x_m", "y_m"]]
        joined = join_published(lap, table[table["device"] == recording.device], spec.site, recording.lap)
        off = np.linalg.norm(joined.sets[["x_m", "y_m"]].to_numpy() - truth.to_numpy(), axis=1)
        assert np.isnan(off).mean() < 0.02, recording.name
        assert np.nanmax(off) < 0.05, recording.name


def test_manifest_is_plain_json(data_root: Path) -> None:
    manifest = json.loads((data_root / "packed" / "office" / "manifest.json").read_text())
    assert {source["path"].split("/")[0] for source in manifest["sources"]} == {"0bdeb2a", "2b19c6c"}
    assert all(len(source["git_blob_sha1"]) == 40 for source in manifest["sources"])
    assert set(manifest["files"]) >= {
        "readings.parquet",
        "intervals.parquet",
        "device_links.parquet",
        "plan.png",
    }
