"""Scores of a path against ground truth, as design §6 counts them.

Only intervals from the first fix on are scored; those before it are counted apart. Where an interval has no fix
the last one is held, except for the metrics that say "fixed" and for those of the stated region. Intervals
without a label are left out. A record pools the intervals of all recordings, which is how the outside checks of
the issue count; for tables, ``mean_over_recordings`` gives recordings equal weights, or their arc length's.

Axes: T intervals of one recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fploc.intervals import REGION_95
from fploc.localizer import Path

Floats = NDArray[np.float64]

COUNTS = ("n", "n_before_first_fix")


@dataclass(frozen=True)
class Scores:
    """Scores of one recording, or of several pooled; NaN where there is nothing to score.

    Args:
        n: Labelled intervals from the first fix on.
        n_before_first_fix: Labelled intervals before it; all of them where there is no fix.
        no_fix_share: Share of the n intervals without a fix of their own.
        rmse_m: Root mean square error, last fix held, metres.
        rmse_fixed_m: Root mean square error over intervals with a fix of their own, metres.
        mae_m: Mean error, last fix held, metres.
        p50_m: Median error, last fix held, metres.
        p90_m: 90 % of errors are below it, last fix held, metres.
        p95_m: 95 % of errors are below it, last fix held, metres.
        coverage95: Share of fixes whose stated 95 % region holds the truth.
        nees: Mean of eᵀP⁻¹e over fixes: 2 for honest covariances.
    """

    n: int
    n_before_first_fix: int
    no_fix_share: float
    rmse_m: float
    rmse_fixed_m: float
    mae_m: float
    p50_m: float
    p90_m: float
    p95_m: float
    coverage95: float
    nees: float


def held_positions(path: Path) -> Floats:
    """Return positions with the last fix held, shape (T, 2), metres; NaN before the first fix."""
    index = np.where(path.fixed, np.arange(len(path.fixed)), -1)
    last = np.maximum.accumulate(index)
    return np.where(last[:, None] >= 0, path.positions_m[last], np.nan)


def held_error_series_m(path: Path, labels_m: Floats) -> Floats:
    """Return the error of every interval, shape (T,), metres; NaN where it is not scored.

    Args:
        path: Of one recording.
        labels_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none.
    """
    errors: Floats = np.linalg.norm(held_positions(path) - labels_m, axis=1)
    return errors


def held_errors_m(path: Path, labels_m: Floats) -> Floats:
    """Return the errors that are scored, shape (n,), metres: labelled intervals from the first fix on.

    Args:
        path: Of one recording.
        labels_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none.
    """
    errors = held_error_series_m(path, labels_m)
    return errors[np.isfinite(errors)]


def fixed_errors_m(path: Path, labels_m: Floats) -> Floats:
    """Return the errors of labelled intervals with a fix of their own, shape (n,), metres.

    Args:
        path: Of one recording.
        labels_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none.
    """
    errors: Floats = np.linalg.norm(path.positions_m - labels_m, axis=1)
    return errors[path.fixed & np.isfinite(errors)]


def normalised_errors(path: Path, labels_m: Floats) -> Floats:
    """Return eᵀP⁻¹e of every labelled fix, shape (n,).

    Args:
        path: Of one recording.
        labels_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none.
    """
    at = path.fixed & np.isfinite(labels_m).all(axis=1)
    errors = (path.positions_m - labels_m)[at]
    scaled = np.linalg.solve(path.covariances_m2[at], errors[..., None])[..., 0]
    return np.asarray((errors * scaled).sum(axis=1))


def score(paths: Sequence[Path], labels_m: Sequence[Floats]) -> Scores:
    """Score recordings, their intervals pooled.

    Args:
        paths: Of each recording.
        labels_m: Ground truth of each, shape (T, 2), metres, site frame; NaN where there is none.
    """
    pairs = list(zip(paths, labels_m, strict=True))
    held = np.concatenate([held_errors_m(path, labels) for path, labels in pairs])
    own = np.concatenate([fixed_errors_m(path, labels) for path, labels in pairs])
    normalised = np.concatenate([normalised_errors(path, labels) for path, labels in pairs])
    labelled = sum(int(np.isfinite(labels).all(axis=1).sum()) for labels in labels_m)
    return replace(
        score_errors(held),
        n_before_first_fix=labelled - held.size,
        no_fix_share=1.0 - own.size / held.size if held.size else np.nan,
        rmse_fixed_m=_root_mean_square(own),
        coverage95=_mean((normalised <= REGION_95).astype(np.float64)),
        nees=_mean(normalised),
    )


def score_errors(held_m: Floats) -> Scores:
    """Return what errors alone say; what needs fixes and covariances is NaN, intervals before them are 0.

    Args:
        held_m: Errors, shape (N,), metres; NaN is not scored.
    """
    held = held_m[np.isfinite(held_m)]
    p50, p90, p95 = np.quantile(held, (0.5, 0.9, 0.95)) if held.size else (np.nan,) * 3
    return Scores(
        n=held.size,
        n_before_first_fix=0,
        no_fix_share=np.nan,
        rmse_m=_root_mean_square(held),
        rmse_fixed_m=np.nan,
        mae_m=_mean(held),
        p50_m=float(p50),
        p90_m=float(p90),
        p95_m=float(p95),
        coverage95=np.nan,
        nees=np.nan,
    )


def mean_over_recordings(scores: Sequence[Scores], weights: Sequence[float] | None = None) -> Scores:
    """Return the mean of every metric over recordings; counts are added up.

    Args:
        scores: Of single recordings. One without any fix has no metrics and counts only in
            ``n_before_first_fix``.
        weights: Of each recording, for example ``arc_length_m``; None for equal ones.
    """
    chosen = np.ones(len(scores)) if weights is None else np.asarray(weights, dtype=np.float64)

    def mean(name: str) -> float:
        values = np.array([getattr(one, name) for one in scores], dtype=np.float64)
        there = np.isfinite(values)
        return float(np.average(values[there], weights=chosen[there])) if there.any() else np.nan

    metrics = {one.name: mean(one.name) for one in fields(Scores) if one.name not in COUNTS}
    return Scores(
        n=sum(one.n for one in scores),
        n_before_first_fix=sum(one.n_before_first_fix for one in scores),
        **metrics,
    )


@dataclass(frozen=True)
class Difference:
    """Difference of the RMSE of two methods on the same intervals, first minus second.

    Args:
        rmse_m: Over the intervals of all recordings, metres.
        low_m: 2.5 % of resampled differences are below it.
        high_m: 97.5 % of resampled differences are below it.
        recordings_m: Of each recording alone, metres; those without a common interval are left out.
    """

    rmse_m: float
    low_m: float
    high_m: float
    recordings_m: tuple[float, ...]


def bootstrap_difference(
    errors_a: Sequence[Floats],
    errors_b: Sequence[Floats],
    t_s: Sequence[Floats],
    *,
    block_s: float = 30.0,
    seed: int = 0,
    resamples: int = 2000,
) -> Difference:
    """Return the difference in RMSE of two methods, and how sure it is, from a bootstrap over blocks of time.

    Errors that follow one another are alike, so that blocks of ``block_s`` seconds are drawn instead of
    intervals (Künsch 1989); a block ends with its recording.

    Args:
        errors_a: Errors of the first method in each recording, shape (T,) each, metres; NaN is not compared.
        errors_b: Of the second method.
        t_s: Device time, shape (T,) each, seconds.
        block_s: Length of a block, seconds.
        seed: Of the resampling.
        resamples: How many times blocks are drawn.
    """
    sums, parts = [], []
    for one, other, times in zip(errors_a, errors_b, t_s, strict=True):
        there = np.isfinite(one) & np.isfinite(other)
        if not there.any():
            continue
        blocks = np.floor((times[there] - times[there][0]) / block_s).astype(np.int64)
        # Columns: squared errors of the first, of the second, number of intervals.
        columns = (one[there] ** 2, other[there] ** 2, np.ones(int(there.sum())))
        of_recording = np.stack([np.bincount(blocks, weights=column) for column in columns], axis=1)
        sums.append(of_recording[of_recording[:, 2] > 0])
        parts.append(_rmse_difference(of_recording.sum(axis=0)))
    if not sums:
        return Difference(float("nan"), float("nan"), float("nan"), ())
    stacked = np.concatenate(sums)
    drawn = np.random.default_rng(seed).integers(len(stacked), size=(resamples, len(stacked)))
    low, high = np.quantile(_rmse_difference(stacked[drawn].sum(axis=1)), (0.025, 0.975))
    return Difference(
        rmse_m=float(_rmse_difference(stacked.sum(axis=0))),
        low_m=float(low),
        high_m=float(high),
        recordings_m=tuple(float(part) for part in parts),
    )


def arc_length_m(labels_m: Floats) -> float:
    """Return the length of a labelled path, metres; intervals without a label are skipped.

    Args:
        labels_m: Ground truth, shape (T, 2), metres, site frame.
    """
    there = labels_m[np.isfinite(labels_m).all(axis=1)]
    return float(np.linalg.norm(np.diff(there, axis=0), axis=1).sum())


def _rmse_difference(sums: Floats) -> Floats:
    """Return √(a/n) − √(b/n) of sums (…, 3) of squared errors a and b and of numbers n."""
    first, second, number = np.moveaxis(sums, -1, 0)
    difference: Floats = np.sqrt(first / number) - np.sqrt(second / number)
    return difference


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else float("nan")


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(_mean(values**2)))
