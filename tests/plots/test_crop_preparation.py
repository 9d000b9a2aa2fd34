from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import CropSettings
from fploc.plots.crop_preparation import plot_crop_preparation, strip_corners
from fploc.sites.site import AccessPoint, Site

CROPS = CropSettings(pixels_per_metre=10.0, width_m=4.0, max_length_px=400, patch_length_px=5)


@pytest.fixture
def plan() -> FloorPlan:
    """20 m × 10 m at 10 px/m with a wall at y = 8 m, from x = 0 to 10 m."""
    grey = np.full((100, 200), 255, np.uint8)
    grey[19:21, :100] = 0
    return FloorPlan("drawn", grey, grey < 200, Georeference.of_raster((0.0, 10.0), 0.1))


def site(*, made_up: bool = False) -> Site:
    points = (
        AccessPoint("AP1", "02:00:00:00:00:01", 5.0, 7.0, 2.0),
        AccessPoint("AP2", "02:00:00:00:00:02", 15.0, 2.0, 2.0),
    )
    return Site("drawn", "drawn", points, device_height_m=1.0, made_up=made_up)


def test_the_strip_runs_from_end_to_end_and_is_as_wide_as_the_crop() -> None:
    level = strip_corners([1.0, 2.0], [6.0, 2.0], 4.0)
    np.testing.assert_allclose(level, [[1, 0], [6, 0], [6, 4], [1, 4]])
    # Turned with the link: a device above the access point has its left hand at smaller x.
    upright = strip_corners([0.0, 0.0], [0.0, 3.0], 2.0)
    np.testing.assert_allclose(upright, [[1, 0], [1, 3], [-1, 3], [-1, 0]], atol=1e-12)


def test_the_crop_below_is_the_plan_inside_the_strip(plan: FloorPlan, tmp_path: Path) -> None:
    figure = plot_crop_preparation(plan, site(), 0, (9.0, 7.0), CROPS, title="crop of AP1")
    above, below = figure.axes
    np.testing.assert_allclose(above.patches[1].get_xy()[:4], strip_corners((5, 7), (9, 7), 4.0))
    (shown,) = below.images
    crop = np.asarray(shown.get_array())
    assert crop.shape == (40, 40) and shown.get_extent() == pytest.approx([0, 4, -2, 2])
    # The wall is 1 m to the left of the link: 10 rows above the middle.
    dark = np.flatnonzero(crop.mean(axis=1) > 0.5)
    assert dark.tolist() == [9, 10]
    assert below.get_xlim() == pytest.approx((0.0, 4.0))
    figure.savefig(tmp_path / "crop.png")


def test_access_point_and_device_are_marked_and_made_up_is_said(plan: FloorPlan) -> None:
    figure = plot_crop_preparation(plan, site(made_up=True), 1, (9.0, 7.0), CROPS, title="crop of AP2")
    drawn = {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
    np.testing.assert_array_equal(drawn["AP2"], [[15.0, 2.0]])
    np.testing.assert_array_equal(drawn["coarse position"], [[9.0, 7.0]])
    np.testing.assert_array_equal(drawn["other access points"], [[5.0, 7.0]])
    assert "made-up" in figure.axes[0].get_title()
