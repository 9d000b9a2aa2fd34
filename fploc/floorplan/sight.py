"""Which places an access point sees, and which lie behind walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import line_of_sight

MOUNTED_WITHIN_M = 0.4
"""Walls so close to either end count for nothing: access points hang on walls, and people brush past them."""


def behind_walls(plan: FloorPlan, access_points_m: ArrayLike, places_m: ArrayLike) -> NDArray[np.bool_]:
    """Return where walls stand between access point and place, shape (…).

    Args:
        plan: The plan.
        access_points_m: Shape (…, 2), metres, site frame.
        places_m: Shape (…, 2), metres, site frame; both broadcast against each other.
    """
    starts, ends = np.broadcast_arrays(
        np.asarray(access_points_m, dtype=np.float64), np.asarray(places_m, dtype=np.float64)
    )
    clear = line_of_sight(plan, starts.reshape(-1, 2), ends.reshape(-1, 2), end_margin_m=MOUNTED_WITHIN_M)
    return ~clear.reshape(starts.shape[:-1])
