"""How measured links are distributed beside generated ones: robust statistics of range error and RSS.

Axes: N readings, A access points. NaN stands for what was not heard and does not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from fploc.evaluation.tables import plain

Floats = NDArray[np.float64]

SPREAD_OF_MAD = 1.482602218505602
"""Standard deviation of a normal distribution over its median absolute deviation: 1 / Φ⁻¹(3/4)."""


@dataclass(frozen=True, eq=False)
class MatchStatistics:
    """Statistics of the readings of each access point; arrays of shape (A,).

    Args:
        n: Number of readings.
        bias_m: Median range error.
        spread_m: Robust standard deviation of the range error along the path.
        skewness: Kelly's skewness of the range error, from −1 to 1; above 0 is skewed to the right.
        local_spread_m: As ``spread_m``, of the error minus its expected value at the place.
        local_skewness: As ``skewness``, of the error minus its expected value at the place.
        rss_dbm: Median signal strength.
        rss_spread_db: Robust standard deviation of the signal strength along the path.
        dependence: Spearman's rank correlation of range error and signal strength; NaN where one is constant.
    """

    n: NDArray[np.int64]
    bias_m: Floats
    spread_m: Floats
    skewness: Floats
    local_spread_m: Floats
    local_skewness: Floats
    rss_dbm: Floats
    rss_spread_db: Floats
    dependence: Floats


def match_statistics(errors_m: Floats, expected_m: Floats, rss_dbm: Floats) -> MatchStatistics:
    """Return the statistics of readings.

    Args:
        errors_m: Range minus true distance, shape (N, A), metres; every access point has at least one.
        expected_m: What the generator expects of it at the same place, shape (N, A), metres.
        rss_dbm: Signal strengths, shape (N, A), dBm; NaN where ``errors_m`` is.
    """
    local = errors_m - expected_m
    return MatchStatistics(
        n=np.isfinite(errors_m).sum(axis=0),
        bias_m=np.nanmedian(errors_m, axis=0),
        spread_m=robust_spread(errors_m),
        skewness=quantile_skewness(errors_m),
        local_spread_m=robust_spread(local),
        local_skewness=quantile_skewness(local),
        rss_dbm=np.nanmedian(rss_dbm, axis=0),
        rss_spread_db=robust_spread(rss_dbm),
        dependence=rank_correlation(errors_m, rss_dbm),
    )


def robust_spread(values: Floats) -> Floats:
    """Return the median absolute deviation of ``values`` (N, A) times 1.4826, shape (A,).

    It equals the standard deviation where the values are normal.
    """
    deviations: Floats = np.abs(values - np.nanmedian(values, axis=0))
    spread: Floats = SPREAD_OF_MAD * np.nanmedian(deviations, axis=0)
    return spread


def quantile_skewness(values: Floats) -> Floats:
    """Return (p90 + p10 − 2·p50) / (p90 − p10) of ``values`` (N, A), shape (A,) (Kelly 1921).

    0 where 10th and 90th percentile are equal: a single value leans to neither side.
    """
    low, middle, high = np.nanpercentile(values, [10.0, 50.0, 90.0], axis=0)
    width = high - low
    return np.divide(high + low - 2.0 * middle, width, out=np.zeros_like(width), where=width > 0)


def rank_correlation(first: Floats, second: Floats) -> Floats:
    """Return Spearman's ρ of ``first`` and ``second`` (N, A), shape (A,); NaN where one is constant."""
    known = np.isfinite(first) & np.isfinite(second)
    ranks = [
        rankdata(np.where(known, values, np.nan), axis=0, nan_policy="omit") for values in (first, second)
    ]
    one, two = (rank - np.nanmean(rank, axis=0) for rank in ranks)
    scale: Floats = np.sqrt(np.nansum(one**2, axis=0) * np.nansum(two**2, axis=0))
    together: Floats = np.nansum(one * two, axis=0)
    return np.divide(together, scale, out=np.full_like(scale, np.nan), where=scale > 0)


def printed_rows(match: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the rows of a ``match.json`` (``fploc synthesize``) as text, ready to print."""
    headings = {
        "bias_m": "bias (m)",
        "spread_m": "spread (m)",
        "skewness": "skewness",
        "local_spread_m": "local spread (m)",
        "local_skewness": "local skewness",
        "rss_dbm": "RSS (dBm)",
        "rss_bias_db": "RSS bias (dB)",
        "rss_spread_db": "RSS spread (dB)",
        "dependence": "RTT–RSS ρ",
    }
    return [
        {
            "AP": row["access_point"],
            "data": row["data"],
            "n": f"{row['n']:,}",
            **{text: plain(row[name]) for name, text in headings.items()},
        }
        for row in match["rows"]
    ]
