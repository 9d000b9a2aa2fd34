"""How sure a comparison is: differences by recording and from a bootstrap, means over recordings.

The rows are plain JSON values, so that a page can be made from them without the errors of every interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fploc.evaluation.error_series import Bools, ErrorSeries
from fploc.evaluation.metrics import Floats, Scores, bootstrap_difference, mean_over_recordings, score_errors
from fploc.evaluation.records import finite_or_none


def difference_rows(
    series: Mapping[str, Sequence[ErrorSeries]], *, base: str, seed: int = 0
) -> list[dict[str, Any]]:
    """Return how far the RMSE of each method is from that of ``base``, a row for each device and method.

    Errors behind the Kalman filter are compared, in blocks of 30 s. A recording counts where both methods
    have it. ``recordings_below`` is in how many recordings ``base`` has the smaller RMSE; ``common_m`` and
    ``common_base_m`` are the RMSE of both over the intervals in which each has a fix of its own, and
    ``common_share`` is how many these are of all that are compared.

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
            pairs = [_Pair.of(errors[key], own[key]) for key in keys]
            difference = bootstrap_difference(
                [one.errors_m for one in pairs],
                [one.base_m for one in pairs],
                [one.t_s for one in pairs],
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
                    **_common(pairs),
                }
            )
    return rows


def rows_against_best(series: Mapping[str, Sequence[ErrorSeries]]) -> list[dict[str, Any]]:
    """Return ``difference_rows`` against the method with the smallest RMSE of each device.

    Args:
        series: Errors of one place by method.
    """
    rows = []
    for device in sorted({one.device for errors in series.values() for one in errors}):
        of_device = {
            method: [one for one in errors if one.device == device] for method, errors in series.items()
        }
        rmse_m = {
            method: score_errors(np.concatenate([one.filtered_m for one in errors])).rmse_m
            for method, errors in of_device.items()
            if errors
        }
        best = min(rmse_m, key=lambda method: (not np.isfinite(rmse_m[method]), rmse_m[method]))
        rows += difference_rows(of_device, base=best)
    return rows


def recording_rows(series: Mapping[str, Sequence[ErrorSeries]]) -> list[dict[str, Any]]:
    """Return RMSE with equal weights of recordings and with their arc length's, by device and method.

    Errors behind a filter count, the method's own or the Kalman filter; ``low_m`` and ``high_m`` are the best
    and the worst recording.

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


@dataclass(frozen=True, eq=False)
class _Pair:
    """Errors of two methods in the intervals of a recording that both have.

    Args:
        t_s: Device time, shape (T,), seconds.
        errors_m: Of the one behind its filter, shape (T,), metres.
        base_m: Of the other.
        both_fixed: True where each has a fix of its own, shape (T,).
    """

    t_s: Floats
    errors_m: Floats
    base_m: Floats
    both_fixed: Bools

    @classmethod
    def of(cls, one: ErrorSeries, base: ErrorSeries) -> _Pair:
        times, at, at_base = np.intersect1d(one.t_s, base.t_s, return_indices=True)
        fixed = one.fixed[at] & base.fixed[at_base]
        return cls(times, one.filtered_m[at], base.filtered_m[at_base], fixed)


def _common(pairs: Sequence[_Pair]) -> dict[str, float | None]:
    """Return the RMSE of both methods where each has a fix of its own."""
    if not pairs:
        return {"common_m": None, "common_base_m": None, "common_share": None}
    errors, base = (np.concatenate([getattr(one, name) for one in pairs]) for name in ("errors_m", "base_m"))
    scored = np.isfinite(errors) & np.isfinite(base)
    both = scored & np.concatenate([one.both_fixed for one in pairs])
    return {
        "common_m": finite_or_none(_root_mean_square(errors[both])),
        "common_base_m": finite_or_none(_root_mean_square(base[both])),
        "common_share": finite_or_none(both.sum() / scored.sum() if scored.any() else float("nan")),
    }


def _root_mean_square(errors_m: Floats) -> float:
    return float(np.sqrt(np.mean(errors_m**2))) if errors_m.size else float("nan")


def _rmse(scores: Scores) -> float | None:
    return finite_or_none(scores.rmse_m)
