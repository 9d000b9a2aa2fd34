from __future__ import annotations

import numpy as np

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walkable import walkable_shares


def test_shares_are_0_in_walls_1_on_the_floor_and_0_beyond_the_plan() -> None:
    walls = np.zeros((100, 100), dtype=bool)
    walls[:, 60:] = True
    plan = FloorPlan(
        "half", np.full((100, 100), 255, np.uint8), walls, Georeference.of_raster([0.0, 10.0], 0.1)
    )
    centres = [[2.0, 5.0], [8.0, 5.0], [5.7, 5.0], [-3.0, 5.0]]
    floor, wall, edge, beyond = walkable_shares(plan, [[3.0, 5.0]], centres, 0.5)
    assert (floor, wall, beyond) == (1.0, 0.0, 0.0)
    # The floor ends at x = 6.0, clearance is 0.3 m: of 5.45 to 5.95 m the first half is free.
    assert 0.3 < edge < 0.7


def test_cells_at_every_edge_count_and_those_beyond_do_not() -> None:
    plan = FloorPlan(
        "free",
        np.full((40, 60), 255, np.uint8),
        np.zeros((40, 60), dtype=bool),
        Georeference.of_raster([0.0, 4.0], 0.1),
    )
    within = [[0.05, 2.0], [5.95, 2.0], [3.0, 3.95], [3.0, 0.05]]
    beyond = [[-0.05, 2.0], [6.05, 2.0], [3.0, 4.05], [3.0, -0.05], [-0.05, 4.05], [-9.0, 2.0], [3.0, 9.0]]
    shares = walkable_shares(plan, [[3.0, 2.0]], within + beyond, 0.1)
    np.testing.assert_array_equal(shares, [1.0] * len(within) + [0.0] * len(beyond))
