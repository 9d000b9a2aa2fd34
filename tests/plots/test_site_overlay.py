from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot
import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan, read_grey_image
from fploc.plots.site_overlay import plot_site_overlay
from fploc.sites.site import AccessPoint, Site


@pytest.fixture
def plan() -> FloorPlan:
    grey = np.full((200, 400), 255, np.uint8)
    grey[40:44] = 0
    grey[100:102, 50:90] = 60
    walls = grey < 200
    walls[100:102] = False
    return FloorPlan("drawn", grey, walls, Georeference.of_raster((0.0, 10.0), 0.05))


def site(made_up: bool) -> Site:
    access_points = tuple(
        AccessPoint(f"AP{number}", f"02:00:00:00:00:0{number}", 4.0 * number, 5.0, 2.0)
        for number in (1, 2, 3)
    )
    return Site("drawn", "drawn", access_points, device_height_m=1.0, made_up=made_up)


def test_everything_is_on_it(plan: FloorPlan, tmp_path: Path) -> None:
    times = np.linspace(0, 1, 50)
    path = np.column_stack([4 + 8 * times, np.full(50, 3.0)])
    paths = {"device 1": path, "device 2": np.where(times[:, None] < 0.5, np.nan, path + 1.0)}
    figure = plot_site_overlay(plan, site(made_up=False), paths)
    (axes,) = figure.axes
    assert axes.get_title() == "drawn"
    lines = {line.get_label(): line for line in axes.lines}
    np.testing.assert_array_equal(lines["device 1"].get_xydata(), path)
    assert len(lines["device 2"].get_xydata()) == 25
    assert lines["device 1"].get_color() != lines["device 2"].get_color()
    assert {text.get_text() for text in axes.texts} >= {"AP1", "AP2", "AP3"}
    assert any(text.get_text().endswith(" m") for text in axes.texts)
    image = axes.images[0]
    assert image.get_extent() == pytest.approx([0, 20, 0, 10])
    colours = np.asarray(image.get_array())
    assert colours[41, 100].max() < 0.3 < colours[100, 60].max() < 0.9
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "device 1",
        "device 2",
        "access point",
    ]
    figure.savefig(tmp_path / "overlay.png")
    assert read_grey_image(tmp_path / "overlay.png").std() > 0


def test_made_up_is_said_and_paths_may_be_missing(plan: FloorPlan, tmp_path: Path) -> None:
    figure = plot_site_overlay(plan, site(made_up=True), {"device 1": np.full((5, 2), np.nan)})
    assert "made-up" in figure.axes[0].get_title()
    figure.savefig(tmp_path / "overlay.png")
    assert plot_site_overlay(plan, site(made_up=True), {}).axes[0].lines


def test_no_figure_is_left_open(plan: FloorPlan) -> None:
    plot_site_overlay(plan, site(made_up=False), {})
    assert matplotlib.pyplot.get_fignums() == []
