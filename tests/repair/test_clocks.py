from __future__ import annotations

import numpy as np

from fploc.repair.clocks import in_order, is_row_grid, rescale


def test_row_grid_is_told_from_a_clock() -> None:
    grid = 200.0 * np.arange(50)
    assert is_row_grid(grid)
    assert not is_row_grid(grid + np.where(np.arange(50) == 30, 1.0, 0.0))
    assert not is_row_grid(300.0 * np.arange(50))
    assert not is_row_grid(grid[:2])


def test_rescaled_time_starts_at_zero_and_lasts_as_the_log() -> None:
    rescaled = rescale(100.0 + 200.0 * np.arange(11), 2060.0)
    assert rescaled[0] == 0.0 and rescaled[-1] == 2060.0
    np.testing.assert_allclose(np.diff(rescaled), 206.0)


def test_rows_below_the_running_maximum_go() -> None:
    t_ms = np.array([0.0, 100.0, 90.0, 95.0, 100.0, 110.0])
    assert in_order(t_ms).tolist() == [True, True, False, False, True, True]
