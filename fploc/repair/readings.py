"""Mending of readings: what a file calls 0, repeats, and ranges that cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.plausible import FARTHEST_RANGE_M, has_range, has_rss
from fploc.raw.lap import Lap

Counts = dict[str, int]


def drop_repeats(lap: Lap) -> tuple[Lap, Counts]:
    """Drop reading sets equal to the one before in every range and RSS; inertial samples differ in each row.

    Returns:
        The lap, and the counts ``repeated_sets`` (of which ``repeated_empty_sets`` hear nothing) and
        ``repeated_readings`` (the readings in them).
    """
    codes, macs = pd.factorize(lap.readings["mac"])
    position = np.searchsorted(lap.sets.index.to_numpy(), lap.readings["set"].to_numpy())
    values = np.zeros((len(lap.sets), len(macs), 2))
    values[position, codes, 0] = lap.readings["range_m"]
    values[position, codes, 1] = lap.readings["rss_dbm"]
    repeated = np.zeros(len(values), dtype=bool)
    repeated[1:] = (values[1:] == values[:-1]).all(axis=(1, 2))
    heard = (values != 0).any(axis=2).sum(axis=1)
    counts = {
        "repeated_sets": int(repeated.sum()),
        "repeated_empty_sets": int((repeated & (heard == 0)).sum()),
        "repeated_readings": int(heard[repeated].sum()),
    }
    return keep_sets(lap, ~repeated), counts


def keep_sets(lap: Lap, keep: NDArray[np.bool_]) -> Lap:
    """Return the lap with the sets where ``keep`` (T,) is True, and their readings; indices stay."""
    if keep.all():
        return lap
    sets = lap.sets[keep]
    readings = lap.readings[lap.readings["set"].isin(sets.index)]
    return replace(lap, sets=sets, readings=readings)


def mend_readings(readings: pd.DataFrame) -> tuple[pd.DataFrame, Counts]:
    """Turn 0 to null, drop outliers and flag far ranges.

    Args:
        readings: With ``range_slant_m``, ``range_plan_m``, ``range_std_m`` and ``rss_dbm``; 0, negative or
            null where there is no range, 0 or null where there is no RSS.

    Returns:
        The readings of access points that were heard, with ``is_far``; and the counts ``range_from_100m``
        (readings dropped), ``range_missing`` (heard without a range; null), ``range_negative`` (of these,
        given as negative), ``rss_missing`` (0 or no level; null), ``far_beyond_60m`` (kept, flagged).
    """
    slant, rss = readings["range_slant_m"].to_numpy(), readings["rss_dbm"].to_numpy()
    std = readings["range_std_m"].to_numpy()
    ranged, levelled, negative = has_range(slant), has_rss(rss), slant < 0
    outlier = (slant > 0) & ~ranged
    kept = (ranged | levelled | negative) & ~outlier
    far = ranged & (slant > FARTHEST_RANGE_M)
    mended = readings.assign(
        range_slant_m=np.where(ranged, slant, np.nan),
        range_plan_m=np.where(ranged, readings["range_plan_m"], np.nan),
        range_std_m=np.where(ranged & (std >= 0), std, np.nan),
        rss_dbm=np.where(levelled, rss, np.nan),
        is_far=far,
    )[kept]
    counts = {
        "range_from_100m": int(outlier.sum()),
        "range_missing": int((kept & ~ranged).sum()),
        "range_negative": int((kept & negative).sum()),
        "rss_missing": int((kept & ~levelled).sum()),
        "far_beyond_60m": int((kept & far).sum()),
    }
    return mended, counts
