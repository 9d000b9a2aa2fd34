"""Covariances as ellipses."""

from __future__ import annotations

import math

from fploc.intervals import REGION_95


def ellipse95(variance_x: float, variance_y: float, covariance: float) -> dict[str, float]:
    """Return the 95 % ellipse of a covariance, square metres, as the fields of ``messages.Ellipse``."""
    mean, half = (variance_x + variance_y) / 2, (variance_x - variance_y) / 2
    spread = math.hypot(half, covariance)
    return {
        "semi_major_m": math.sqrt(REGION_95 * max(mean + spread, 0.0)),
        "semi_minor_m": math.sqrt(REGION_95 * max(mean - spread, 0.0)),
        "angle_rad": 0.5 * math.atan2(2 * covariance, 2 * half),
    }
