from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.sight import MOUNTED_WITHIN_M, behind_walls

FREE = FloorPlan(
    "wall at 5 m",
    np.full((100, 100), 255, np.uint8),
    np.zeros((100, 100), dtype=bool),
    Georeference.of_raster([0.0, 10.0], 0.1),
)
"""10 m by 10 m."""
COLUMNS = np.arange(100) // 2 == 25
"""From x = 5.0 to 5.2 m."""
WALLED = replace(FREE, walls=np.broadcast_to(COLUMNS, (100, 100)))


def test_a_wall_hides_what_is_behind_it_and_nothing_else() -> None:
    access_points = np.array([[2.0, 5.0], [8.0, 5.0]])
    places = np.array([[1.0, 1.0], [3.0, 9.0], [7.0, 2.0], [9.0, 8.0]])
    hidden = behind_walls(WALLED, access_points[:, None], places)
    assert hidden.tolist() == [[False, False, True, True], [True, True, False, False]]
    assert not behind_walls(FREE, access_points[:, None], places).any()


@pytest.mark.parametrize("at_m", [5.0 - 0.5 * MOUNTED_WITHIN_M, 5.2 + 0.1 * MOUNTED_WITHIN_M])
def test_the_wall_that_an_access_point_hangs_on_hides_nothing(at_m: float) -> None:
    assert behind_walls(WALLED, [at_m, 5.0], [[1.0, 5.0], [9.0, 5.0]]).tolist() == [False, False]


def test_pairs_and_single_places_are_taken() -> None:
    assert behind_walls(WALLED, [[2.0, 5.0], [8.0, 5.0]], [[1.0, 1.0], [1.0, 1.0]]).tolist() == [False, True]
    assert behind_walls(WALLED, [2.0, 5.0], [9.0, 5.0]).shape == ()
