from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot
import numpy as np
import pytest
from matplotlib.container import BarContainer

from fploc.floorplan.plan import read_grey_image
from fploc.plots.bars import RmseRow, plot_rmse_bars

ROWS = [
    RmseRow("mall\ndevice 1", "nls", 2.0),
    RmseRow("mall\ndevice 1", "gnn", 1.0, paper_m=(1.5, 1.2)),
    RmseRow("mall\ndevice 1", "gnn", 3.0, paper_m=(1.5, 1.2)),
    RmseRow("laboratory\ndevice 1", "nls", 4.0),
    RmseRow("laboratory\ndevice 1", "gnn", None),
]


def bars(figure) -> dict[str, BarContainer]:
    (axes,) = figure.axes
    return {one.get_label(): one for one in axes.containers if isinstance(one, BarContainer)}


def test_bars_are_means_over_seeds_with_their_spread() -> None:
    drawn = bars(plot_rmse_bars(ROWS, "zero-shot"))
    assert list(drawn) == ["nls", "gnn"]
    heights = {name: [bar.get_height() for bar in container] for name, container in drawn.items()}
    assert heights["nls"] == [2.0, 4.0]
    np.testing.assert_array_equal(heights["gnn"], [2.0, np.nan])
    (segments,) = [lines.get_segments() for lines in drawn["gnn"].errorbar.lines[2]]
    assert np.asarray(segments[0])[:, 1] == pytest.approx([2.0 - np.sqrt(2.0), 2.0 + np.sqrt(2.0)])


def test_bars_of_one_place_do_not_overlap() -> None:
    drawn = bars(plot_rmse_bars(ROWS, "zero-shot"))
    first, second = (container[0] for container in (drawn["nls"], drawn["gnn"]))
    assert first.get_x() + first.get_width() < second.get_x()
    assert abs(first.get_x() + second.get_x() + second.get_width()) < 1e-9


def test_the_paper_stands_on_its_own_bar_once(tmp_path: Path) -> None:
    figure = plot_rmse_bars(ROWS, "zero-shot")
    (axes,) = figure.axes
    (diamonds,) = [line for line in axes.lines if line.get_label() == "paper"]
    bar = bars(figure)["gnn"][0]
    centre = bar.get_x() + bar.get_width() / 2
    np.testing.assert_allclose(diamonds.get_xydata(), [(centre, 1.5), (centre, 1.2)])
    assert [text.get_text() for text in axes.get_xticklabels()] == ["mall\ndevice 1", "laboratory\ndevice 1"]
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"nls", "gnn", "paper"}
    figure.savefig(tmp_path / "bars.png")
    assert read_grey_image(tmp_path / "bars.png").std() > 0


def test_made_up_is_said_and_no_figure_is_left_open() -> None:
    figure = plot_rmse_bars([RmseRow("made-up-1", "nls", 2.0)], "zero-shot", made_up=True)
    assert "made-up" in figure.axes[0].get_title()
    assert plot_rmse_bars([], "nothing").axes
    assert matplotlib.pyplot.get_fignums() == []
