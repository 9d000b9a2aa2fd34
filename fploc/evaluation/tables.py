"""Numbers as they stand in tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

UNKNOWN = "–"
NOT_RUN = "not run"
MISSING = f"{NOT_RUN.capitalize()}.\n"
"""Stands where a table would, had it been run."""


def mean_text(values: Sequence[float | None], *, decimals: int = 2) -> str:
    """Return the mean of the known values, of several with ± sample standard deviation; a dash for none."""
    known = [value for value in values if value is not None]
    if not known:
        return UNKNOWN
    mean = f"{np.mean(known):.{decimals}f}"
    return mean if len(known) == 1 else f"{mean} ± {np.std(known, ddof=1):.{decimals}f}"


def plain(value: float | None, *, decimals: int = 2) -> str:
    """Return a number, a dash for none."""
    return UNKNOWN if value is None else f"{value:.{decimals}f}"


def signed(value: float | None) -> str:
    """Return a difference with its sign, a dash for none."""
    return UNKNOWN if value is None else f"{value:+.2f}".replace("-", "−")


def thousands(value: float | None) -> str:
    """Return a count with commas, a dash for none."""
    return UNKNOWN if value is None else f"{value:,.0f}"


def listed(names: Iterable[str | None]) -> str:
    """Return each name once, sorted, with commas; a dash where there is none."""
    return ", ".join(sorted({name or UNKNOWN for name in names})) or UNKNOWN
