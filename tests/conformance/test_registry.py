"""Every site file of the registry, against the lists of public files and the AP lists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.source_files import listed_file
from fploc.raw.ap_sheet import read_ap_sheet
from fploc.repair.labels import KINDS
from fploc.sites.registry import known_sites, load_spec

MACS = {
    "AP1": "b0:e4:d5:39:26:89",
    "AP2": "cc:f4:11:8b:29:4d",
    "AP3": "b0:e4:d5:01:26:f5",
    "AP4": "b0:e4:d5:91:ba:5d",
    "AP5": "b0:e4:d5:96:3b:95",
    "AP6": "f8:1a:2b:06:3c:0b",
    "AP7": "14:22:3b:2a:86:f5",
    "AP8": "14:22:3b:16:5a:bd",
}
# AP lists of these sites number their six access points 1 to 6.
COMPACT_SHEETS = {
    "AP_idx_Canteen",
    "AP_idx_CarPark",
    "AP_idx_Library",
    "AP_idx_library",
    "AP_idx_Shopping Mall",
}

NINE = {
    "office",
    "office-position1",
    "office-position2",
    "conference-room",
    "laboratory",
    "library",
    "shopping-mall",
    "canteen",
    "carpark",
}

SITES = pytest.mark.parametrize("name", known_sites())


def test_registry_holds_the_nine_layouts() -> None:
    assert set(known_sites()) >= NINE
    places = {name: load_spec(name).site.place for name in NINE}
    on_office_floor = {name for name, place in places.items() if place == "office-floor"}
    assert on_office_floor == {"office", "office-position1", "office-position2", "conference-room"}
    assert len(set(places.values())) == 6


@SITES
def test_site_is_complete(name: str) -> None:
    spec = load_spec(name)
    assert spec.site.name == name and not spec.site.made_up
    assert [ap.mac for ap in spec.site.access_points] == [MACS[ap.name] for ap in spec.site.access_points]
    assert (spec.site.height_differences_m == 0.5).all()
    assert len(spec.site.access_points) in (6, 8)
    assert {repair.kind for repair in spec.repairs.values()} <= set(KINDS)
    assert all(repair.origin for repair in spec.repairs.values())
    assert spec.faults and spec.access_points_origin and spec.description and spec.plan.notes
    assert {recording.device for recording in spec.recordings} <= {1, 2}


@SITES
def test_files_are_the_pinned_ones(name: str) -> None:
    spec = load_spec(name)
    for file in (*spec.files, *spec.sheets):
        assert file.revision is not None
        assert listed_file(file.revision, file.path).blob_sha1 == file.blob_sha1


@SITES
def test_access_points_lie_on_the_plan(name: str) -> None:
    spec = load_spec(name)
    left, top = spec.plan.origin_m
    size_m = np.array(spec.plan.size_px) * spec.plan.metres_per_pixel
    offset = (spec.site.positions_m - [left, top]) * [1, -1]
    assert ((offset > 0) & (offset < size_m)).all()


@SITES
def test_plan_shows_no_path(name: str) -> None:
    path = load_spec(name).plan.file.path
    leaking = {"Laboratory", "Canteen", "Library", "CarPark", "Conference Room"}
    assert not (path.startswith("raw_data/") and path.split("/")[1] in leaking)


@SITES
def test_coordinates_are_those_of_the_ap_lists(name: str, source: Path) -> None:
    spec = load_spec(name)
    names = [ap.name for ap in spec.site.access_points]
    paths = [spec.locate(sheet, source) for sheet in spec.sheets]
    present = [path for path in paths if path.is_file()]
    assert bool(present) == (name != "office")
    for path in present:
        sheet = read_ap_sheet(path)
        compact = path.stem in COMPACT_SHEETS and len(sheet.access_points) == len(names)
        at = [sheet.access_points[f"AP{index}" if compact else ap] for index, ap in enumerate(names, start=1)]
        np.testing.assert_allclose(spec.site.positions_m, at, err_msg=str(path))
        assert sheet.macs == {} or sheet.macs == dict(zip(names, spec.site.macs, strict=True))


def test_held_out_sites_list_their_recordings() -> None:
    canteen, carpark = load_spec("canteen"), load_spec("carpark")
    assert [(r.device, r.name) for r in carpark.recordings] == [
        (1, "513"),
        (1, "613"),
        (2, "524"),
        (2, "624"),
    ]
    assert len(canteen.recordings) == 16 and len(canteen.links) == 8
    assert carpark.true_distance_faults == ("AP2", "AP5")


def test_alternative_pose_of_the_mall_is_no_zero_shot() -> None:
    alternative = load_spec("shopping-mall").plan.alternative
    assert alternative is not None and not alternative.allowed_in_zero_shot
