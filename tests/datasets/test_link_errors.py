from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.link_errors import link_errors
from fploc.datasets.packed import read_packed
from fploc.datasets.recordings import Recording
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.sites.site import AccessPoint, Site

WALL_X_M = 5.0


@pytest.fixture
def plan() -> FloorPlan:
    """A wall from top to bottom, 20 cm thick."""
    grey = np.full((200, 200), 255, np.uint8)
    grey[:, 98:102] = 0
    return FloorPlan("wall", grey, grey < 128, Georeference.of_raster((0.0, 10.0), 0.05))


SITE = Site(
    "wall",
    "wall",
    (
        AccessPoint("AP1", "02:00:00:00:00:01", 1.0, 5.0, 2.0),
        AccessPoint("AP2", "02:00:00:00:00:02", 9.0, 5.0, 2.0),
    ),
    device_height_m=1.0,
)


def recording(positions: np.ndarray[tuple[int, int], np.dtype[np.float64]], error_m: float) -> Recording:
    distance = np.linalg.norm(positions[:, None] - SITE.positions_m, axis=2)
    slant = np.nan_to_num(np.hypot(distance, 1.0) + error_m)
    return Recording(
        site="wall", device=1, name="1", t_s=np.arange(len(positions), dtype=np.float64), slant_m=slant,
        std_m=np.zeros_like(slant), rss_dbm=np.full_like(slant, -50.0), heard=slant > 0,
        published_m=positions, repaired_m=positions + np.array([0.0, 1.0]),
    )  # fmt: skip


def test_errors_are_in_space_and_walls_are_counted(plan: FloorPlan) -> None:
    lap = recording(np.array([[2.0, 5.0], [8.0, 5.0]]), error_m=1.5)
    errors = link_errors(SITE, plan, [lap], "published")
    np.testing.assert_allclose(errors.error_m, 1.5)
    assert errors.access_point.tolist() == [0, 1, 0, 1]
    assert errors.walls.tolist() == [0, 1, 1, 0]
    np.testing.assert_allclose(errors.distance_m[0], np.hypot(1.0, 1.0))
    np.testing.assert_array_equal(errors.place_m[:2], [[2.0, 5.0], [2.0, 5.0]])
    repaired = link_errors(SITE, plan, [lap], "repaired")
    np.testing.assert_allclose(repaired.distance_m[0], np.sqrt(3.0))


def test_what_has_no_range_no_label_or_is_far_is_left_out(plan: FloorPlan) -> None:
    lap = recording(np.array([[2.0, 5.0], [np.nan, np.nan], [8.0, 5.0]]), error_m=1.0)
    slant = lap.slant_m.copy()
    slant[0, 1], slant[2, 0] = 0.0, 61.0
    errors = link_errors(SITE, plan, [replace(lap, slant_m=slant)], "published")
    assert list(zip(errors.t_s, errors.access_point, strict=True)) == [(0.0, 0), (2.0, 1)]


def test_one_access_point_keeps_its_rows(plan: FloorPlan) -> None:
    laps = [recording(np.array([[2.0, 5.0], [8.0, 5.0]]), error) for error in (1.0, 2.0)]
    own = link_errors(SITE, plan, laps, "published").of_access_point(1)
    assert own.access_point.tolist() == [1] * 4 and own.walls.tolist() == [1, 0, 1, 0]
    np.testing.assert_allclose(own.error_m, [1.0, 1.0, 2.0, 2.0])


def test_walls_make_ranges_of_a_made_up_building_longer(made_up_root: Path) -> None:
    packed = read_packed(made_up_root, "made-up-5")
    errors = link_errors(packed.site, packed.plan, packed.recordings(), "repaired")
    free, behind = errors.error_m[errors.walls == 0], errors.error_m[errors.walls >= 2]
    assert np.median(behind) > np.median(free) + 0.5


def test_a_range_far_below_the_distance_is_impossible(plan: FloorPlan) -> None:
    laps = [recording(np.array([[4.0, 5.0]]), error) for error in (-1.4, -1.6)]
    assert link_errors(SITE, plan, laps, "published").is_impossible.tolist() == [False, False, True, True]
