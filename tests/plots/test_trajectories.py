from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.plots.trajectories import plot_trajectories
from fploc.sites.site import AccessPoint, Site

PLAN = FloorPlan(
    "hall",
    np.full((100, 200), 255, np.uint8),
    np.zeros((100, 200), bool),
    Georeference.of_raster((0.0, 10.0), 0.1),
)
TRUTH = np.column_stack([np.linspace(2.0, 12.0, 20), np.full(20, 4.0)])


def site(*, made_up: bool = False) -> Site:
    points = (
        AccessPoint("AP1", "02:00:00:00:00:01", 2.0, 8.0, 2.0),
        AccessPoint("AP2", "02:00:00:00:00:02", 15.0, 2.0, 2.0),
    )
    return Site("hall", "hall", points, device_height_m=1.0, made_up=made_up)


def test_every_stage_has_a_panel_with_truth_estimates_and_access_points(tmp_path: Path) -> None:
    far = TRUTH.copy()
    far[:3] += 100.0
    far[3] = np.nan
    stages = {"coarse": TRUTH + 1.0, "smoothed": TRUTH, "solved": far}
    figure = plot_trajectories(PLAN, site(), TRUTH, stages, title="hall")
    assert [axes.get_title() for axes in figure.axes] == ["coarse", "smoothed", "solved (3 of 19 outside)"]
    for axes, positions in zip(figure.axes, stages.values(), strict=True):
        drawn = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
        np.testing.assert_array_equal(drawn["estimated"], positions)
        np.testing.assert_array_equal(drawn["ground truth"], TRUTH)
        np.testing.assert_array_equal(drawn["access points"], [[2.0, 8.0], [15.0, 2.0]])
        assert axes.get_xlim() == pytest.approx((-3.0, 20.0)) and axes.get_ylim() == pytest.approx(
            (-3.0, 13.0)
        )
    assert {text.get_text() for text in figure.axes[0].texts} == {"AP1", "AP2"}
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "x [m]", "x [m]"]
    assert figure.get_suptitle() == "hall"
    figure.savefig(tmp_path / "stages.png")


def test_one_stage_and_made_up_buildings() -> None:
    figure = plot_trajectories(PLAN, site(made_up=True), TRUTH, {"only": TRUTH}, title="hall")
    assert len(figure.axes) == 1 and "made-up" in figure.get_suptitle()
