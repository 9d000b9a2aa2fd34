from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.grid import PlaceGrid
from fploc.floorplan.plan import FloorPlan
from fploc.plots.generator_maps import centred_limits, plot_generator_maps, shown_limits
from fploc.sites.site import AccessPoint, Site

PLAN = FloorPlan(
    name="hall",
    grey=np.full((100, 200), 255, dtype=np.uint8),
    walls=np.zeros((100, 200), dtype=bool),
    georeference=Georeference.of_raster((0.0, 10.0), 0.1),
)
GRID = PlaceGrid(2.0, 1.0, 0.5, rows=4, columns=6)


def site(number: int = 3, *, made_up: bool = False) -> Site:
    points = tuple(
        AccessPoint(f"AP{one}", f"02:00:00:00:00:0{one}", 3.0 * one, 5.0, 2.0) for one in range(number)
    )
    return Site("hall", "hall", points, device_height_m=1.0, made_up=made_up)


def values(number: int = 3) -> np.ndarray:
    made = np.arange(number * 24, dtype=np.float64).reshape(number, 4, 6)
    made[:, 0, 0] = np.nan
    return made


def test_a_panel_for_each_access_point_with_its_values_star_and_plan(tmp_path: Path) -> None:
    figure = plot_generator_maps(
        PLAN, site(), GRID, values(), title="hall", label="RSS [dBm]", colours="plasma", limits=(-1.0, 70.0)
    )
    *panels, bar = figure.axes
    assert [panel.get_title() for panel in panels] == ["AP0", "AP1", "AP2"]
    assert bar.get_ylabel() == "RSS [dBm]"
    for index, panel in enumerate(panels):
        plan, shown = panel.images
        assert plan.get_extent() == pytest.approx([0, 20, 0, 10])
        assert shown.get_extent() == pytest.approx([2, 5, 1, 3]) and shown.origin == "lower"
        np.testing.assert_array_equal(np.ma.filled(shown.get_array(), np.nan), values()[index])
        assert shown.get_clim() == (-1.0, 70.0)
        np.testing.assert_array_equal(panel.lines[0].get_xydata(), [[3.0 * index, 5.0]])
    figure.savefig(tmp_path / "maps.png")


def test_access_points_without_values_and_made_up_buildings_say_so() -> None:
    made = values()
    made[1] = np.nan
    figure = plot_generator_maps(
        PLAN, site(made_up=True), GRID, made, title="hall", label="m", colours="viridis", limits=(0.0, 1.0)
    )
    assert [panel.get_title() for panel in figure.axes[:3]] == ["AP0", "AP1: nothing here", "AP2"]
    assert "made-up" in figure.get_suptitle()


def test_one_access_point_fills_the_figure() -> None:
    figure = plot_generator_maps(
        PLAN, site(1), GRID, values(1), title="hall", label="m", colours="viridis", limits=(0.0, 1.0)
    )
    assert len(figure.axes) == 2


def test_limits_hold_all_but_the_farthest_values() -> None:
    spread = np.append(np.linspace(-2.0, 6.0, 1001), [500.0, np.nan])
    low, high = shown_limits(spread)
    assert (low, high) == pytest.approx((-1.92, 5.93), abs=0.02)
    assert centred_limits(spread) == (-high, high)
    assert shown_limits(np.full(3, np.nan)) == (0.0, 1.0)
    low, high = shown_limits(np.full(3, 2.0))
    assert low == 2.0 < high
