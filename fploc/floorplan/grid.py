"""Square cells laid over a part of a site: for maps of what was computed or measured at places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlaceGrid:
    """Cells in rows upwards along y and columns along x.

    Args:
        left_m: Least x of the cells, metres, site frame.
        bottom_m: Least y of the cells, metres, site frame.
        step_m: Side of a cell.
        rows: Number of cells along y.
        columns: Number of cells along x.
    """

    left_m: float
    bottom_m: float
    step_m: float
    rows: int
    columns: int

    @classmethod
    def covering(cls, places_m: ArrayLike, step_m: float) -> PlaceGrid:
        """Return the smallest grid that holds all of ``places_m`` (N, 2), its lines at multiples of the step."""
        cells = _floor(np.asarray(places_m, dtype=np.float64) / step_m)
        low = cells.min(axis=0)
        columns, rows = (cells.max(axis=0) - low).astype(int) + 1
        return cls(float(low[0] * step_m), float(low[1] * step_m), step_m, int(rows), int(columns))

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge, metres."""
        right_m = self.left_m + self.columns * self.step_m
        return self.left_m, right_m, self.bottom_m, self.bottom_m + self.rows * self.step_m

    def cells_of(self, places_m: ArrayLike) -> NDArray[np.int64]:
        """Return the cell of each of ``places_m`` (N, 2) inside the grid, shape (N,), counted row by row."""
        places = np.asarray(places_m, dtype=np.float64) - [self.left_m, self.bottom_m]
        column, row = _floor(places / self.step_m).astype(np.int64).T
        assert ((column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)).all()
        cells: NDArray[np.int64] = row * self.columns + column
        return cells

    def centres_m(self, cells: NDArray[np.int64]) -> Floats:
        """Return the centres of cells (N,), shape (N, 2), metres."""
        row, column = np.divmod(cells, self.columns)
        return np.stack([column + 0.5, row + 0.5], axis=-1) * self.step_m + [self.left_m, self.bottom_m]

    def means(self, places_m: ArrayLike, values: Floats) -> Floats:
        """Return the mean of ``values`` (N, A) at ``places_m`` (N, 2) in each cell, shape (A, rows, columns).

        NaN values do not count; a cell without any value is NaN.
        """
        number, size = values.shape[1], self.rows * self.columns
        known = np.isfinite(values)
        index = self.cells_of(places_m)[:, None] + size * np.arange(number)
        count = np.bincount(index[known], minlength=number * size)
        total = np.bincount(index[known], weights=values[known], minlength=number * size)
        means = np.divide(total, count, out=np.full(number * size, np.nan), where=count > 0)
        return means.reshape(number, self.rows, self.columns)


def _floor(steps: Floats) -> Floats:
    """Round down; a place on a line between cells is above it, whatever the last digits of the quotient."""
    return np.floor(np.round(steps, 6))
