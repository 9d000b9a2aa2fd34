from __future__ import annotations

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.plots.free_space import plot_free_space
from fploc.sites.site import AccessPoint, Site


def test_free_cells_lie_where_they_are_on_the_plan() -> None:
    grey = np.full((100, 200), 255, np.uint8)
    plan = FloorPlan("drawn", grey, grey < 128, Georeference.of_raster((0.0, 5.0), 0.05))
    free = np.zeros((100, 200), dtype=np.bool_)
    free[:50] = True
    site = Site(
        "drawn", "drawn", (AccessPoint("AP1", "02:00:00:00:00:01", 5.0, 2.5, 2.0),), 1.0, made_up=True
    )
    (axes,) = plot_free_space(plan, site, free, title="drawn").axes
    drawn, cells = axes.images
    assert cells.get_extent() == drawn.get_extent() == pytest.approx((0.0, 10.0, 0.0, 5.0))
    mask = np.ma.getmaskarray(cells.get_array())
    assert not mask[:50].any() and mask[50:].all()
    assert "made-up" in axes.get_title()
