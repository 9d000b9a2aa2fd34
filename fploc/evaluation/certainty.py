"""How sure a comparison is: differences by recording and from a bootstrap, means over recordings.

The rows are plain JSON values, so that a page can be made from them without the errors of every interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fploc.evaluation.error_series import ErrorSeries
from fploc.evaluation.metrics import Floats, Scores, bootstrap_difference, mean_over_recordings, score_errors
from fploc.evaluation.records import finite_or_none


def difference_rows(
    series: Mapping[str, Sequence[ErrorSeries]], *, base: str, seed: int = 0
) -> list[dict[str, Any]]:
    """Return how far the RMSE of each method is from that of ``base``, a row for each device and method.

    Errors behind the Kalman filter are compared, in blocks of 30 s. A recording counts where both methods
    have it. ``recordings_below`` is in how many recordings ``base`` has the smaller RMSE.

    Args:
        series: Errors of one place by method; nothing is compared where ``base`` is not among them.
        base: The method that is subtracted: a row above 0 is worse than it.
        seed: Of the bootstrap.
    """
    rows = []
    by_method = {
        method: {(one.device, one.recording): one for one in errors} for method, errors in series.items()
    }
    own = by_method.pop(base, {})
    for device in sorted({device for device, _ in own}):
        for method, errors in by_method.items():
            keys = [key for key in own if key[0] == device and key in errors]
            pairs = [_paired(errors[key], own[key]) for key in keys]
            difference = bootstrap_difference(
                [one for one, _, _ in pairs],
                [other for _, other, _ in pairs],
                [times for _, _, times in pairs],
                seed=seed,
            )
            rows.append(
                {
                    "device": device,
                    "method": method,
                    "base": base,
                    "rmse_m": finite_or_none(difference.rmse_m),
                    "low_m": finite_or_none(difference.low_m),
                    "high_m": finite_or_none(difference.high_m),
                    "recordings": len(difference.recordings_m),
                    "recordings_below": sum(one > 0 for one in difference.recordings_m),
                }
            )
    return rows


def recording_rows(series: Mapping[str, Sequence[ErrorSeries]]) -> list[dict[str, Any]]:
    """Return RMSE with equal weights of recordings and with their arc length's, by device and method.

    Errors behind the Kalman filter count; ``low_m`` and ``high_m`` are the best and the worst recording.

    Args:
        series: Errors of one place by method.
    """
    rows = []
    for method, errors in series.items():
        for device in sorted({one.device for one in errors}):
            of_device = [one for one in errors if one.device == device]
            scores = [score_errors(one.filtered_m) for one in of_device]
            alone = [one.rmse_m for one in scores if np.isfinite(one.rmse_m)]
            rows.append(
                {
                    "device": device,
                    "method": method,
                    "recordings": len(alone),
                    "rmse_m": _rmse(mean_over_recordings(scores)),
                    "rmse_by_arc_m": _rmse(
                        mean_over_recordings(scores, [one.arc_length_m for one in of_device])
                    ),
                    "low_m": min(alone, default=None),
                    "high_m": max(alone, default=None),
                }
            )
    return rows


def _paired(one: ErrorSeries, other: ErrorSeries) -> tuple[Floats, Floats, Floats]:
    """Return errors of both and times of the intervals that both have, by their time."""
    times, at_one, at_other = np.intersect1d(one.t_s, other.t_s, return_indices=True)
    return one.filtered_m[at_one], other.filtered_m[at_other], times


def _rmse(scores: Scores) -> float | None:
    return finite_or_none(scores.rmse_m)
