"""Every filter by its name, made for the speed at which people walk."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fploc.filters.interface import Filter
from fploc.filters.kalman import BatchedFilter, KalmanSettings


def _kalman(speed_mps: float) -> Filter:
    return BatchedFilter(KalmanSettings.for_speed(speed_mps))


FILTERS: Mapping[str, Callable[[float], Filter]] = {"kalman": _kalman}
"""Takes the speed prior, metres per second."""
