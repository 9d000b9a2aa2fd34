"""What `fploc tune` may change of each method, and how far.

The likelihood of ``bayes-grid`` was fitted on the source before, and the path loss of ``rtt-rss`` too. The trees of
``gbm`` stay as they are: more of them remember the source's line better, which its validation lap runs along too.
``nls`` is unweighted by definition and has nothing to tune: ``nls-weighted`` is what tuning makes of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fploc.calibration.offsets import ESTIMATORS


@dataclass(frozen=True)
class Interval:
    """Numbers between two bounds.

    Args:
        key: Of the setting, which stands once in the method's file.
        low: Least.
        high: Greatest.
        is_log: Whether factors count alike, and not differences.
    """

    key: str
    low: float
    high: float
    is_log: bool = True


@dataclass(frozen=True)
class Count:
    """Whole numbers between two bounds; as ``Interval``, factors count alike."""

    key: str
    low: int
    high: int


@dataclass(frozen=True)
class Choice:
    """One of several.

    Args:
        key: Of the setting, which stands once in the method's file.
        options: To choose from.
    """

    key: str
    options: tuple[str, ...]


Dimension = Interval | Count | Choice

CALIBRATION = Choice("calibration", ESTIMATORS)
REACH = Interval("reach_m", 2.0, 30.0)
ADVANTAGE = Interval("advantage", 0.1, 1.0)
SIGMAS = (Interval("sigma_m", 0.3, 3.0), Interval("sigma_per_m", 0.0, 0.3, is_log=False))

SPACES: Mapping[str, Sequence[Dimension]] = {
    "lls": (*SIGMAS, REACH, CALIBRATION),
    "nls-weighted": (*SIGMAS, ADVANTAGE, CALIBRATION),
    "nls-robust": (
        Interval("scale", 0.2, 3.0),
        Interval("sigma_per_m", 0.0, 0.3, is_log=False),
        ADVANTAGE,
        CALIBRATION,
    ),
    "nls-onesided": (
        Interval("short_weight", 1.0, 16.0),
        Interval("long_scale", 0.1, 1.0),
        Interval("sigma_per_m", 0.0, 0.3, is_log=False),
        ADVANTAGE,
        CALIBRATION,
    ),
    "trilateration": (Interval("smallest_sine", 0.05, 0.5), REACH, CALIBRATION),
    "rtt-rss": (
        Interval("noise_m2_per_s", 0.02, 2.0),
        Interval("rtt_variance_m2", 0.3, 10.0),
        Interval("rss_sd_db", 3.0, 15.0),
        CALIBRATION,
    ),
    "bayes-grid": (Interval("floor_per_m", 1e-6, 1e-2), Interval("correlation_s", 0.1, 20.0)),
    "cbt-wccg": (
        Interval("shift_sd_m", 0.3, 2.0),
        Interval("cell_m", 0.4, 2.0),
        Interval("kernel_m", 0.4, 2.0),
        CALIBRATION,
    ),
    "knn": (Count("neighbours", 1, 64), Interval("range_sd_m", 0.2, 5.0), Interval("rss_sd_db", 1.0, 20.0)),
    "gbm": (
        Interval("scale", 0.3, 3.0),
        Interval("smallest_sigma_m", 0.1, 2.0),
        ADVANTAGE,
        CALIBRATION,
    ),
}
