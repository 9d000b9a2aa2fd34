from __future__ import annotations

import numpy as np
import pytest

from fploc.plots.link_errors import plot_errors_by_walls, plot_link_over_time, walls_text


@pytest.mark.parametrize(
    ("walls", "text"), [(0, "0 walls"), (1, "1 wall"), (2, "2 walls"), (3, "3 or more walls")]
)
def test_walls_are_told_in_words(walls: int, text: str) -> None:
    assert walls_text(walls) == text


def test_each_number_of_walls_has_its_median_and_its_share() -> None:
    walls = np.array([0] * 10 + [1] * 5 + [3] * 4 + [7])
    error_m = 0.5 + np.minimum(walls, 3)
    figure = plot_errors_by_walls(error_m.astype(np.float64), walls, "site", made_up=True)
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "0 walls: median +0.50 m, 10 readings",
        "1 wall: median +1.50 m, 5 readings",
        "3 or more walls: median +3.50 m, 5 readings",
    ]
    assert "made-up" in axes.get_title()
    for patch in axes.patches:
        assert max(patch.get_xy()[:, 1]) == pytest.approx(100.0)


def test_no_readings_make_an_empty_figure() -> None:
    figure = plot_errors_by_walls(np.empty(0), np.empty(0, dtype=np.int64), "site")
    assert figure.axes[0].get_legend() is None and figure.axes[0].get_title() == "site"


def test_a_link_is_drawn_as_it_was_measured() -> None:
    t_s, walls = np.arange(4.0), np.array([0, 1, 2, 1])
    rss_dbm = np.array([-40.0, 0.0, -60.0, -50.0])
    figure = plot_link_over_time(t_s, t_s + 3.0, t_s + 2.0, rss_dbm, walls, "AP1", made_up=True)
    above, middle, below = figure.axes
    np.testing.assert_array_equal(above.lines[0].get_ydata(), t_s + 3.0)
    np.testing.assert_array_equal(above.lines[1].get_ydata(), t_s + 2.0)
    np.testing.assert_array_equal(middle.lines[0].get_ydata(), [-40.0, np.nan, -60.0, -50.0])
    assert below.get_ylim()[1] > 2 and "made-up" in above.get_title()
