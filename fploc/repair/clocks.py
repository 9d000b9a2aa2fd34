"""Mending of time stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Some cleaned laps count rows of the inertial sensors as if each took exactly this long.
ROW_STEP_MS = 200.0
_TOLERANCE_MS = 1e-3
_FEWEST_ROWS = 3


def is_row_grid(t_ms: Floats) -> bool:
    """Return whether every step of the times (T,) is exactly 200 ms: then they count rows, not time."""
    if len(t_ms) < _FEWEST_ROWS:
        return False
    return bool((np.abs(np.diff(t_ms) - ROW_STEP_MS) < _TOLERANCE_MS).all())


def rescale(t_ms: Floats, duration_ms: float) -> Floats:
    """Return times (T,) of a row grid stretched to the duration that the phone's own log has."""
    rescaled: Floats = (t_ms - t_ms[0]) * (duration_ms / (t_ms[-1] - t_ms[0]))
    return rescaled


def in_order(t_ms: Floats) -> NDArray[np.bool_]:
    """Return where times (T,) do not lie below their running maximum."""
    kept: NDArray[np.bool_] = t_ms >= np.maximum.accumulate(t_ms)
    return kept
