"""Markdown tables, and numbers as they stand in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

UNKNOWN = "–"


def markdown(rows: Sequence[Mapping[str, str]]) -> str:
    """Return rows of equal keys as a Markdown table; nothing for no rows."""
    if not rows:
        return ""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def mean_text(values: Sequence[float | None], *, decimals: int = 2) -> str:
    """Return the mean of the known values, of several with ± sample standard deviation; a dash for none."""
    known = [value for value in values if value is not None]
    if not known:
        return UNKNOWN
    mean = f"{np.mean(known):.{decimals}f}"
    return mean if len(known) == 1 else f"{mean} ± {np.std(known, ddof=1):.{decimals}f}"
