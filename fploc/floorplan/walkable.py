"""How much of each cell of a grid a walker can stand on."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from fploc.floorplan.georeference import Floats
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import free_space


def walkable_shares(plan: FloorPlan, seeds_m: ArrayLike, centres_m: ArrayLike, cell_m: float) -> Floats:
    """Return the share of each cell that is free space, shape (C,), 0 to 1; 0 beyond the plan.

    Args:
        plan: The plan.
        seeds_m: Where a walker may start, for example the access points, shape (A, 2), metres.
        centres_m: Of the cells, shape (C, 2), metres, site frame.
        cell_m: Side of a cell, metres.

    Raises:
        FplocError: If no cell is free near any seed.
    """
    free = free_space(plan, seeds_m).astype(np.float64)
    side = max(1, round(cell_m * plan.georeference.pixels_per_metre))
    shares = cv2.blur(free, (side, side), borderType=cv2.BORDER_CONSTANT)
    column, row = np.round(plan.georeference.to_pixels(centres_m)).astype(np.int64).T
    height, width = shares.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return np.where(inside, shares[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)
