from __future__ import annotations

import numpy as np
import pytest

from fploc.floorplan.grid import PlaceGrid


def test_it_covers_the_places_and_its_lines_are_multiples_of_the_step() -> None:
    grid = PlaceGrid.covering([[-0.6, 1.2], [2.4, 3.9]], 0.5)
    assert grid == PlaceGrid(-1.0, 1.0, 0.5, rows=6, columns=7)
    assert grid.extent_m == (-1.0, 2.5, 1.0, 4.0)


def test_a_place_is_half_a_step_from_the_centre_of_its_cell_at_most() -> None:
    places = np.random.default_rng(0).uniform([-30.0, 5.0], [40.0, 17.0], (500, 2))
    grid = PlaceGrid.covering(places, 0.25)
    cells = grid.cells_of(places)
    assert np.abs(grid.centres_m(cells) - places).max() <= 0.125 + 1e-5
    np.testing.assert_array_equal(grid.cells_of(grid.centres_m(np.arange(50))), np.arange(50))


def test_places_on_a_line_are_in_the_cell_above_it() -> None:
    places = np.array([[0.1, 0.7], [0.3, 0.7], [0.6, 0.7]])
    grid = PlaceGrid.covering(places, 0.1)
    np.testing.assert_array_equal(grid.cells_of(places), [0, 2, 5])
    assert (grid.rows, grid.columns) == (1, 6)


def test_means_of_cells() -> None:
    grid = PlaceGrid(0.0, 0.0, 1.0, rows=2, columns=3)
    places = [[0.2, 0.5], [0.8, 0.5], [2.5, 1.5], [2.1, 1.1]]
    values = np.array([[1.0, np.nan], [3.0, 5.0], [7.0, np.nan], [7.0, np.nan]])
    means = grid.means(places, values)
    assert means.shape == (2, 2, 3)
    nan = np.nan
    np.testing.assert_array_equal(means[0], [[2.0, nan, nan], [nan, nan, 7.0]])
    np.testing.assert_array_equal(means[1], [[5.0, nan, nan], [nan, nan, nan]])


def test_means_equal_a_loop_over_cells() -> None:
    random = np.random.default_rng(1)
    places, values = random.uniform(0, 5, (300, 2)), random.normal(size=(300, 2))
    grid = PlaceGrid.covering(places, 1.0)
    means, cells = grid.means(places, values), grid.cells_of(places)
    for cell in np.unique(cells):
        row, column = divmod(int(cell), grid.columns)
        assert means[:, row, column] == pytest.approx(values[cells == cell].mean(axis=0))
