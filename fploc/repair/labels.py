"""Repairs of ground truth: pure functions whose constants stand in the site files.

Each kind of repair in a site file is one function here; published labels are kept beside the repaired ones.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fploc.errors import FplocError, UnknownNameError
from fploc.sites.registry import RepairSpec

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Labels on the top edge differ from its y by the rounding of the public files (1.5 mm at most).
_EDGE_TOLERANCE_M = 0.002


@dataclass(frozen=True, eq=False)
class Labels:
    """Ground truth of the rows of one lap, in file order.

    Args:
        recording: Name of the lap's file.
        t_s: Time since the first row, shape (T,), seconds.
        positions_m: Shape (T, 2), metres, site frame; NaN where none.
        keep: False where a row does not belong to the lap, shape (T,).
    """

    recording: str
    t_s: Floats
    positions_m: Floats
    keep: Bools


def repair_labels(labels: Labels, repair: RepairSpec) -> Labels:
    """Apply one repair of a site file.

    Raises:
        UnknownNameError: If there is no such kind of repair.
        FplocError: If a constant is missing, unknown or cannot be used.
    """
    if repair.kind not in KINDS:
        raise UnknownNameError(
            f"repair {repair.name}, kind",
            repair.kind,
            known=sorted(KINDS),
            way_out="correct it in the site file",
        )
    function = KINDS[repair.kind]
    wanted = [name for name in inspect.signature(function).parameters if name != "labels"]
    if sorted(repair.constants) != sorted(wanted):
        raise FplocError(
            f"repair {repair.name}, constants",
            value=", ".join(sorted(repair.constants)),
            expected=", ".join(sorted(wanted)),
            way_out="correct them in the site file",
        )
    return function(labels, **repair.constants)


def moved_seam(
    labels: Labels,
    *,
    seam_x_m: float,
    labelled_seam_x_m: float,
    top_edge_y_m: float,
    right_end_x_m: float,
    left_end_x_m: float,
    right_lag_m: float,
    left_lag_m: float,
    fade_end_y_m: float,
) -> Labels:
    """Move the seam of a loop to where the robot really started and ended, and delay its two upper turns.

    The loop runs from the seam along the top edge to its right end, down, back along the bottom, up, and
    along the top edge from its left end to the seam. On the first part of the top edge (rows before the
    smallest x) labels are stretched linearly from [labelled seam, right end] to [seam, right end − right
    lag]; on the last part from [left end, labelled seam] to [left end − left lag, seam]. Beside the top
    edge, down to ``fade_end_y_m``, labels move back along their own path by a lag that fades to 0.
    """
    position = labels.positions_m
    x, y = position[:, 0], position[:, 1]
    rows = np.arange(len(position))
    on_first_half = rows <= np.argmin(x)
    moved = position.copy()

    right_start = right_end_x_m - right_lag_m
    first = on_first_half & (y >= top_edge_y_m - _EDGE_TOLERANCE_M) & (x <= right_end_x_m)
    stretch = (right_start - seam_x_m) / (right_end_x_m - labelled_seam_x_m)
    moved[first, 0] = seam_x_m + (x[first] - labelled_seam_x_m) * stretch

    left_start = left_end_x_m - left_lag_m
    last = ~on_first_half & (y >= top_edge_y_m - _EDGE_TOLERANCE_M) & (x >= left_end_x_m)
    stretch = (seam_x_m - left_start) / (labelled_seam_x_m - left_end_x_m)
    moved[last, 0] = left_start + (x[last] - left_end_x_m) * stretch

    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))]
    lag = np.zeros(len(position))
    for side, edge, lag_m in ((on_first_half, first, right_lag_m), (~on_first_half, last, left_lag_m)):
        fading = side & ~edge & (y > fade_end_y_m)
        if fading.any():
            ends = arc[fading][[0, -1]]
            # The lag is full at the end that touches the top edge: the first row when going down.
            share = (arc[fading] - ends[0]) / max(ends[1] - ends[0], _EDGE_TOLERANCE_M)
            lag[fading] = lag_m * (1 - share if side is on_first_half else share)
    back = lag > 0
    for axis in (0, 1):
        moved[back, axis] = np.interp(arc[back] - lag[back], arc, position[:, axis])
    return _with(labels, moved)


def delayed_lap(labels: Labels, *, first_row: int, start_s: float, duration_s: float) -> Labels:
    """Keep the rows of the lap alone and spread the published polyline over its true duration.

    The published label was spread evenly over the whole log, which holds an aborted run and a parked phone
    before the lap: label(t) = published at the fraction (t − start) / duration of its own time.
    """
    fraction = np.clip((labels.t_s - start_s) / duration_s, 0.0, 1.0)
    own = np.linspace(0.0, 1.0, len(labels.t_s))
    moved = np.stack([np.interp(fraction, own, labels.positions_m[:, axis]) for axis in (0, 1)], axis=1)
    keep = labels.keep & (np.arange(len(own)) >= first_row)
    return Labels(recording=labels.recording, t_s=labels.t_s, positions_m=moved, keep=keep)


def stretched_leg(
    labels: Labels, *, below_y_m: float, fixed_y_m: float, true_length_m: float, labelled_length_m: float
) -> Labels:
    """Stretch the labels below a line along y, away from a fixed line, from the labelled length to the true."""
    y = labels.positions_m[:, 1]
    stretched = fixed_y_m + (y - fixed_y_m) * (true_length_m / labelled_length_m)
    moved = labels.positions_m.copy()
    moved[:, 1] = np.where(y < below_y_m, stretched, y)
    return _with(labels, moved)


def shift(labels: Labels, *, x_m: float, y_m: float) -> Labels:
    """Move all labels by one vector."""
    return _with(labels, labels.positions_m + np.array([x_m, y_m]))


def corner_times(
    labels: Labels,
    *,
    start_m: Sequence[float],
    corners_m: ArrayLike,
    turns_s: dict[str, Sequence[float]],
) -> Labels:
    """Reconstruct the labels of a closed lap from the times at its corners, linear in time on every leg.

    ``turns_s`` holds, for each recording, when each corner is reached and when the lap ends at its start.
    """
    if labels.recording not in turns_s:
        raise UnknownNameError(
            "recording in turns_s", labels.recording, known=sorted(turns_s), way_out="add it in the site file"
        )
    path = np.vstack(
        [np.reshape(start_m, (1, 2)), np.reshape(corners_m, (-1, 2)), np.reshape(start_m, (1, 2))]
    )
    times = np.r_[0.0, np.asarray(turns_s[labels.recording], dtype=np.float64)]
    if len(times) != len(path):
        raise FplocError(
            f"turns_s of {labels.recording}",
            value=f"{len(times) - 1} times",
            expected=f"{len(path) - 1}: one for each corner, and the end",
            way_out="correct them in the site file",
        )
    moved = np.stack([np.interp(labels.t_s, times, path[:, axis]) for axis in (0, 1)], axis=1)
    return _with(labels, moved)


def _with(labels: Labels, positions_m: Floats) -> Labels:
    return Labels(recording=labels.recording, t_s=labels.t_s, positions_m=positions_m, keep=labels.keep)


KINDS: dict[str, Callable[..., Labels]] = {
    "moved-seam": moved_seam,
    "delayed-lap": delayed_lap,
    "stretched-leg": stretched_leg,
    "shift": shift,
    "corner-times": corner_times,
}
