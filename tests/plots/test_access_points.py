from __future__ import annotations

import numpy as np

from fploc.plots.access_points import plot_access_points

RMSE_M = {"nls": {4: 1.5, 3: 2.0}, "gnn": {3: 1.0}}


def test_lines_go_over_the_number_of_access_points_in_order() -> None:
    (axes,) = plot_access_points(RMSE_M, "zero-shot, library").axes
    drawn = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_array_equal(drawn["nls"], [(3, 2.0), (4, 1.5)])
    np.testing.assert_array_equal(drawn["gnn"], [(3, 1.0)])
    assert axes.get_ylim()[0] == 0.0
    assert len({line.get_color() for line in axes.lines}) == 2


def test_made_up_buildings_are_said_to_be_so() -> None:
    figures = (plot_access_points(RMSE_M, "box", made_up=made_up) for made_up in (False, True))
    assert [("made-up" in figure.axes[0].get_title().lower()) for figure in figures] == [False, True]
