"""What counts as a range and as a signal strength: one rule for what is stored and for what comes in live."""

from __future__ import annotations

from typing import Any, TypeVar

from numpy.typing import NDArray
from torch import Tensor

NEVER_HEARD_FROM_M = 100.0
"""Ranges from here on are outliers (up to 56,425 m in the public files); no access point is heard that far."""
FARTHEST_RANGE_M = 60.0
"""Ranges beyond it are faults of the phones (docs/data.md): kept and flagged, but networks neither learn from them
nor use them."""
WEAKEST_DBM = -120.0
"""Android reports -127 dBm where it does not know."""

Values = TypeVar("Values", NDArray[Any], Tensor)


def has_range(slant_m: Values) -> Values:
    """Return where ranges are such, of any shape; metres, 0, negative or NaN where there is none."""
    return (slant_m > 0.0) & (slant_m < NEVER_HEARD_FROM_M)


def has_rss(rss_dbm: Values) -> Values:
    """Return where signal strengths are such, of any shape; dBm, 0 or NaN where there is none."""
    return (rss_dbm >= WEAKEST_DBM) & (rss_dbm < 0.0)
