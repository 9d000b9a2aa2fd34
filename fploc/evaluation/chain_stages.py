"""The paper's chain stage by stage: how far ranges and positions are off before and after each part.

Axes: T intervals of one recording, A access points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import recorded_intervals
from fploc.datasets.recordings import Recording
from fploc.evaluation.metrics import score
from fploc.evaluation.records import finite_or_none
from fploc.filters.kalman import KalmanSettings
from fploc.intervals import Estimate
from fploc.localizer import Path, flat, localize
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site

Floats = NDArray[np.float64]

STAGES = ("GNN", "GNN + KF", "GNN + FPDNN", "GNN + FPDNN + KF")


@dataclass(frozen=True, eq=False)
class ChainTrack:
    """What every stage made of one recording.

    Args:
        recording: The recording.
        paths: Positions after each of ``STAGES``.
        ranges_m: Calibrated ranges in the plan, shape (T, A), metres; NaN where not heard or beyond 60 m.
        corrected_m: FPDNN's distances, shape (T, A), metres; NaN where it was not asked.
    """

    recording: Recording
    paths: dict[str, Path]
    ranges_m: Floats
    corrected_m: Floats


def chain_tracks(
    method: GNNFPDNN,
    site: Site,
    recordings: Sequence[Recording],
    offsets: RangeOffsets,
    filter_settings: KalmanSettings,
) -> list[ChainTrack]:
    """Run the chain and keep what comes after each stage.

    Args:
        method: The chain, ready to run at ``site``.
        site: Where the recordings were made.
        recordings: At least one.
        offsets: Range offsets to remove.
        filter_settings: Of the Kalman filter on the final positions; the one on coarse positions, which come
            before the crops, is the method's.
    """
    coarse = localize(method.coarse, site, recordings, offsets, method.filter.settings)
    final = localize(method, site, recordings, offsets, filter_settings)
    tracks = []
    for before, after in zip(coarse, final, strict=True):
        assert before.filtered is not None and after.filtered is not None, "both were asked for a filter"
        ranges_m, corrected_m = _ranges(method, site, before.recording, offsets, before.filtered)
        paths = (before.unfiltered, before.filtered, after.unfiltered, after.filtered)
        tracks.append(
            ChainTrack(before.recording, dict(zip(STAGES, paths, strict=True)), ranges_m, corrected_m)
        )
    return tracks


def chain_stages(tracks: Sequence[ChainTrack], site: Site, labels: str) -> dict[str, float | None]:
    """Return errors by stage, metres: mean absolute ones of ranges, RMSE of positions with the last fix held.

    ``range_raw_mae_m`` and ``range_fpdnn_mae_m`` are over the same links: those that FPDNN corrected and
    whose true distance is known. ``GNN`` and the other names of ``STAGES`` hold the RMSE after each stage.
    What is undefined is None.

    Args:
        tracks: Of one device; their intervals are pooled.
        site: Where they were made.
        labels: Kind of ground truth.
    """
    truths = [track.recording.labels_m(labels) for track in tracks]
    distances = [np.linalg.norm(truth[:, None] - site.positions_m, axis=2) for truth in truths]
    raw = np.concatenate([track.ranges_m - d for track, d in zip(tracks, distances, strict=True)])
    corrected = np.concatenate([track.corrected_m - d for track, d in zip(tracks, distances, strict=True)])
    there = np.isfinite(raw) & np.isfinite(corrected)
    positions = {stage: score([track.paths[stage] for track in tracks], truths).rmse_m for stage in STAGES}
    found = {
        "links": float(there.sum()),
        "range_raw_mae_m": _mean_absolute(raw[there]),
        "range_fpdnn_mae_m": _mean_absolute(corrected[there]),
        **positions,
    }
    return {name: finite_or_none(value) for name, value in found.items()}


def _ranges(
    method: GNNFPDNN, site: Site, recording: Recording, offsets: RangeOffsets, coarse: Path
) -> tuple[Floats, Floats]:
    """Return the ranges of a recording before and after FPDNN, as ``ChainTrack`` holds them."""
    intervals = flat(recorded_intervals([recording], site, offsets)).nearer_than(FARTHEST_RANGE_M)
    heard = intervals.heard.numpy()
    access_points = method.coarse.init(site, len(recording))
    step = method.rows_at_once(len(site.access_points))
    chunks = [slice(start, start + step) for start in range(0, len(recording), step)]
    with torch.inference_mode():
        corrected = [
            method.corrected_ranges(intervals.at(at), access_points, _estimate(coarse, at)) for at in chunks
        ]
    return (
        np.where(heard, intervals.ranges.numpy(), np.nan),
        np.where(heard & coarse.fixed[:, None], torch.cat(corrected).numpy(), np.nan),
    )


def _estimate(path: Path, at: slice) -> Estimate:
    return Estimate(
        positions=torch.from_numpy(path.positions_m[at]),
        covariances=torch.from_numpy(path.covariances_m2[at]),
        reasons=torch.from_numpy(path.reasons[at]),
    )


def _mean_absolute(values: Floats) -> float:
    return float(np.abs(values).mean()) if values.size else float("nan")
