from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.plots.split import plot_split
from fploc.sites.site import AccessPoint, Site

PLAN = FloorPlan(
    "hall",
    np.full((100, 200), 255, np.uint8),
    np.zeros((100, 200), bool),
    Georeference.of_raster((0.0, 10.0), 0.1),
)
PATH = np.column_stack([np.linspace(2.0, 12.0, 5), np.full(5, 4.0)])


def site(*, made_up: bool = False) -> Site:
    return Site(
        "hall", "hall", (AccessPoint("AP1", "02:00:00:00:00:01", 2.0, 8.0, 2.0),), 1.0, made_up=made_up
    )


def test_paths_of_a_part_are_not_joined_and_earlier_parts_are_wider(tmp_path: Path) -> None:
    figure = plot_split(
        PLAN, site(), {"trains": [PATH, PATH + 1.0], "tests": [PATH], "nothing": []}, title="hall"
    )
    (axes,) = figure.axes
    lines = {line.get_label(): line for line in axes.lines}
    trains = np.asarray(lines["trains"].get_xydata())
    np.testing.assert_array_equal(trains[:5], PATH)
    assert np.isnan(trains[5]).all()
    np.testing.assert_array_equal(trains[6:11], PATH + 1.0)
    widths = [lines[name].get_linewidth() for name in ("trains", "tests", "nothing")]
    assert widths == sorted(widths, reverse=True) and len(set(widths)) == 3
    assert len({lines[name].get_color() for name in ("trains", "tests", "nothing")}) == 3
    assert np.isnan(np.asarray(lines["nothing"].get_xydata())).all()
    assert axes.get_xlim() == pytest.approx((-1.0, 16.0)) and axes.get_title() == "hall"
    figure.savefig(tmp_path / "split.png")


def test_made_up_is_said() -> None:
    assert "made-up" in plot_split(PLAN, site(made_up=True), {"tests": [PATH]}, title="a").axes[0].get_title()
