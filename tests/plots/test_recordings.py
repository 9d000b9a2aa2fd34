from __future__ import annotations

import numpy as np

from fploc.plots.recordings import (
    LONGEST_STEP_S,
    MeasuredValues,
    plot_heard_shares,
    plot_measured_values,
    plot_time_steps,
)


def values(heard: float) -> MeasuredValues:
    few = np.array([0.1, 0.2])
    return MeasuredValues(
        np.array([5.0, 90.0]), np.array([-50.0, -60.0]), few, np.full(3, heard), few, np.empty(0)
    )


def test_every_device_has_a_line_in_every_panel() -> None:
    figure = plot_measured_values({"device 1": values(3), "device 2": values(5)}, "site", made_up=True)
    assert len(figure.axes) == 6 and all(len(axes.patches) == 2 for axes in figure.axes)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["device 1", "device 2"]
    assert "made-up" in figure.get_suptitle()
    # Two ranges, one of them beyond the axis: half of them each.
    assert max(figure.axes[0].patches[0].get_xy()[:, 1]) == 50.0


def test_no_device_makes_an_empty_figure() -> None:
    assert not plot_measured_values({}, "site").axes[0].patches


def test_shares_stand_in_their_cells() -> None:
    shares = np.array([[1.0, 0.0], [0.22, 0.5]])
    figure = plot_heard_shares(["a", "b"], ["AP1", "AP2"], shares, "site", made_up=True)
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["100", "0", "22", "50"]
    assert axes.texts[0].get_color() == "white" and axes.texts[1].get_color() == "black"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b"]


def test_a_gap_is_told_and_drawn_at_the_edge() -> None:
    figure = plot_time_steps({"a": np.array([0.0, 0.5, 6.3]), "b": np.array([0.0])}, "site")
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["longest 5.8 s", "longest 0.0 s"]
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [0.5, LONGEST_STEP_S])
