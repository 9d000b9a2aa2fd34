"""Numbers as they stand in tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

UNKNOWN = "–"


def mean_text(values: Sequence[float | None], *, decimals: int = 2) -> str:
    """Return the mean of the known values, of several with ± sample standard deviation; a dash for none."""
    known = [value for value in values if value is not None]
    if not known:
        return UNKNOWN
    mean = f"{np.mean(known):.{decimals}f}"
    return mean if len(known) == 1 else f"{mean} ± {np.std(known, ddof=1):.{decimals}f}"
