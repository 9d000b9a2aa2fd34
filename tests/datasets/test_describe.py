"""Descriptions of packed sites: counts that add up, and a picture of each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.build import build_sites
from fploc.datasets.croissant import validate_croissant
from fploc.datasets.describe import describe, table_rows, write_overlays
from fploc.datasets.packed import packed_folder, read_manifest, read_packed
from fploc.errors import FplocError, MissingFileError

SITES = ["conference-room", "library"]


@pytest.fixture(scope="module")
def data_root(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    build_sites(source, root, SITES)
    return root


def test_every_reading_of_the_files_is_kept_or_dropped_for_a_reason(data_root: Path) -> None:
    for site in describe(data_root, SITES):
        totals = read_manifest(packed_folder(data_root, site.site))["totals"]
        assert [device.device for device in site.devices] == [1, 2]
        for device in site.devices:
            counts = totals[f"device{device.device}"]
            assert device.readings + sum(device.dropped_readings.values()) == counts["readings_in_file"]
            assert device.intervals + sum(device.dropped_sets.values()) == counts["rows"]
            assert device.ranges == device.readings - device.masked["range_missing"]


def test_every_reason_is_explained_on_the_data_page(data_root: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "data.md").read_text("utf-8")
    for site in SITES:
        manifest = read_manifest(packed_folder(data_root, site))
        kinds = ("dropped_sets", "dropped_readings", "dropped", "masked")
        entries = manifest["recordings"] + manifest["device_links"]
        reasons = {reason for entry in entries for kind in kinds for reason in entry.get(kind, {})}
        assert [reason for reason in sorted(reasons) if f"`{reason}`" not in page] == []


def test_counts_are_those_of_the_tables(data_root: Path) -> None:
    (site,) = describe(data_root, ["library"])
    packed = read_packed(data_root, "library")
    assert (site.access_points, site.device_links) == (6, len(packed.device_links))
    for device in site.devices:
        rows = packed.intervals[packed.intervals["device"] == device.device]
        assert device.recordings == rows["recording"].nunique() == 4
        assert device.intervals == device.labelled == len(rows)
        span = rows.groupby("recording")["t_ms"].agg(np.ptp)
        assert device.duration_s == pytest.approx(span.sum() / 1000)
        # The library's vehicles drive straight lines: one y each.
        assert device.label_box_m is not None
        x_min, y_min, x_max, y_max = device.label_box_m
        assert (x_min, x_max) == pytest.approx((0, 25), abs=0.1) and y_min == y_max
        assert device.label_shift_m == 0


def test_the_repair_of_one_lap_shows_in_the_shift_of_its_device_only(data_root: Path) -> None:
    (site,) = describe(data_root, ["conference-room"])
    first, second = site.devices
    assert first.label_shift_m is not None and first.label_shift_m > 1
    assert second.label_shift_m == 0


def test_rows_name_only_reasons_that_count_something(data_root: Path) -> None:
    rows = table_rows(describe(data_root, SITES))
    assert [(row["site"], row["device"]) for row in rows] == [
        (site, device) for site in SITES for device in ("1", "2")
    ]
    assert rows[0]["dropped sets"] == "outside lap 2,361; repeated 388"
    assert rows[2]["dropped sets"] == "0"


def test_the_json_form_holds_everything(data_root: Path) -> None:
    (site,) = describe(data_root, ["library"])
    document = json.loads(json.dumps(site.to_json()))
    assert document["site"] == "library" and len(document["devices"]) == 2
    assert document["devices"][0]["masked"] == site.devices[0].masked


def test_overlays_are_pictures_with_the_paths_drawn(data_root: Path, tmp_path: Path) -> None:
    from matplotlib.image import imread

    written = write_overlays(data_root, SITES, tmp_path / "pictures")
    assert written == [tmp_path / "pictures" / f"{site}.png" for site in SITES]
    assert sorted((tmp_path / "pictures").iterdir()) == written
    for path in written:
        colours = imread(path)[..., :3]
        saturated = (colours.max(axis=-1) - colours.min(axis=-1)) > 0.5
        assert min(colours.shape[:2]) > 300 and saturated.sum() > 1000


def test_a_folder_that_cannot_be_written_is_named(data_root: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(FplocError, match=r"taken/library\.png"):
        write_overlays(data_root, ["library"], tmp_path / "taken")


def test_a_site_that_is_not_packed_is_named_with_the_way_to_pack_it(data_root: Path) -> None:
    with pytest.raises(MissingFileError, match=r"office.*fploc data build"):
        describe(data_root, ["office"])


def test_built_sites_keep_to_croissant(data_root: Path) -> None:
    for site in SITES:
        validate_croissant(packed_folder(data_root, site))
