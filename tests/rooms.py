"""Sites that tests of several folders stand in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.sites.site import AccessPoint, Site


def room(places: Sequence[tuple[float, float]], *, height_m: float = 2.0) -> Site:
    """Return a site with access points at ``places``, metres, all of one height, and devices at 1 m."""
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, height_m)
            for index, (x, y) in enumerate(places)
        ),
        device_height_m=1.0,
    )


def open_plan(site: Site) -> FloorPlan:
    """Return a plan of a site and 2 m around it without a wall, 0.1 m a pixel."""
    low, high = site.positions_m.min(axis=0) - 2.0, site.positions_m.max(axis=0) + 2.0
    width, height = np.ceil((high - low) * 10).astype(int).tolist()
    walls = np.zeros((height, width), dtype=bool)
    grey = np.full(walls.shape, 255, dtype=np.uint8)
    return FloorPlan("open", grey, walls, Georeference.of_raster([low[0], high[1]], 0.1))
