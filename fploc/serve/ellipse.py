"""Covariances as ellipses."""

from __future__ import annotations

import math

CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of χ² with two degrees of freedom."""


def ellipse95(variance_x: float, variance_y: float, covariance: float) -> dict[str, float]:
    """Return the 95 % ellipse of a covariance, square metres, as the fields of ``messages.Ellipse``."""
    mean, half = (variance_x + variance_y) / 2, (variance_x - variance_y) / 2
    spread = math.hypot(half, covariance)
    return {
        "semi_major_m": math.sqrt(CHI_SQUARE_95 * max(mean + spread, 0.0)),
        "semi_minor_m": math.sqrt(CHI_SQUARE_95 * max(mean - spread, 0.0)),
        "angle_rad": 0.5 * math.atan2(2 * covariance, 2 * half),
    }
