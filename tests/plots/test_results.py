from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import AxesImage

from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.plots.results import plot_cdf, plot_tracks
from fploc.sites.site import AccessPoint, Site

PLAN = FloorPlan(
    name="hall",
    grey=np.full((200, 300), 255, dtype=np.uint8),
    walls=np.zeros((200, 300), dtype=bool),
    georeference=Georeference([[10.0, 0.0, 50.0], [0.0, -10.0, 150.0]]),
)


def site(*, made_up: bool) -> Site:
    return Site(
        name="hall",
        place="hall",
        access_points=(AccessPoint("AP1", "02:00:00:00:00:01", 0.0, 0.0, 2.0),),
        device_height_m=1.0,
        made_up=made_up,
    )


def test_cdf_reaches_each_share_at_its_quantile() -> None:
    axes = plot_cdf({"nls": np.array([4.0, 1.0, np.nan, 3.0, 2.0])}, "hall").axes[0]
    (line,) = axes.get_lines()
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [0.25, 0.5, 0.75, 1.0])
    assert axes.get_title() == "hall" and "[m]" in axes.get_xlabel()


def test_cdf_of_a_method_without_any_fix_is_drawn_empty() -> None:
    axes = plot_cdf({"nls": np.full(3, np.nan), "gnn": np.ones(2)}, "hall").axes[0]
    assert [len(np.asarray(line.get_xdata())) for line in axes.get_lines()] == [0, 2]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["nls", "gnn"]


def test_figures_of_made_up_data_say_so(tmp_path: Path) -> None:
    truth = np.zeros((2, 2))
    figures = {
        True: [plot_cdf({}, "a", made_up=True), plot_tracks(PLAN, site(made_up=True), truth, {}, "a")],
        False: [plot_cdf({}, "a"), plot_tracks(PLAN, site(made_up=False), truth, {}, "a")],
    }
    for made_up, both in figures.items():
        assert all(("made-up" in figure.axes[0].get_title()) == made_up for figure in both)
    both[1].savefig(tmp_path / "track.png")
    assert (tmp_path / "track.png").stat().st_size > 1000


def test_the_plan_lies_under_the_tracks_in_metres() -> None:
    truth = np.array([[0.0, 0.0], [10.0, 5.0], [np.nan, np.nan]])
    figure = plot_tracks(PLAN, site(made_up=False), truth, {"nls": truth + 1.0}, "hall")
    axes = figure.axes[0]
    (image,) = [child for child in axes.get_children() if isinstance(child, AxesImage)]
    assert image.get_extent() == pytest.approx([-5.05, 24.95, -4.95, 15.05])
    assert axes.get_xlim() == pytest.approx((-4.0, 14.0)) and axes.get_ylim() == pytest.approx((-4.0, 9.0))
    drawn = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.get_lines()}
    np.testing.assert_array_equal(drawn["nls"], truth + 1.0)
    np.testing.assert_array_equal(drawn["access points"], [[0.0, 0.0]])
