"""Two parts of each recording's path with a gap between them: one to learn from, one to test on (design §6).

Parts are cut along the path. Where a path comes back to places of a first part, its own or another recording's,
these are not tested: no tested interval lies within the gap of a learned one. Labels are the repaired ones for
every use of the parts.

Axes: T intervals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fploc.datasets.recordings import Recording
from fploc.sites.site import Site

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

GAP_M = 1.0
LABELS = "repaired"
FITTED_SHARE = 0.8
"""Share of the first part, along the path, that networks learn from; the rest of it validates them."""


def along_path_m(labels_m: Floats) -> Floats:
    """Return how far along its path a device is, shape (T,), metres; between labels by linear interpolation.

    Args:
        labels_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none. Without any, nobody
            has moved.
    """
    known = np.flatnonzero(np.isfinite(labels_m).all(axis=1))
    if not known.size:
        return np.zeros(len(labels_m))
    steps = np.linalg.norm(np.diff(labels_m[known], axis=0), axis=1)
    return np.interp(np.arange(len(labels_m)), known, np.concatenate([[0.0], np.cumsum(steps)]))


def halves(recording: Recording) -> tuple[Bools, Bools]:
    """Return which intervals are in the first and the second half of the path's length, shape (T,) each."""
    along = along_path_m(recording.labels_m(LABELS))
    beyond = along - along[-1] / 2
    return beyond < -GAP_M / 2, beyond > GAP_M / 2


def sides(recording: Recording, site: Site) -> tuple[Bools, Bools]:
    """Return which labelled intervals are left and right of the middle of the access points, shape (T,) each."""
    x_m = site.positions_m[:, 0]
    beyond = recording.labels_m(LABELS)[:, 0] - (x_m.min() + x_m.max()) / 2
    return beyond < -GAP_M / 2, beyond > GAP_M / 2


def apart(recordings: Sequence[Recording], parts: Sequence[tuple[Bools, Bools]]) -> list[tuple[Bools, Bools]]:
    """Return first and second parts without what of the second ones lies within the gap of any first one.

    Args:
        recordings: Of one site.
        parts: Of each, shape (T,) each.
    """
    places = [one.labels_m(LABELS) for one in recordings]
    learned = np.concatenate([where[first] for where, (first, _) in zip(places, parts, strict=True)])
    learned = learned[np.isfinite(learned).all(axis=1)]
    if not learned.size:
        return list(parts)
    tree = KDTree(learned)
    return [
        (first, second & ~_near(tree, where)) for where, (first, second) in zip(places, parts, strict=True)
    ]


def _near(tree: KDTree, places: Floats) -> Bools:
    """Return which places, shape (T, 2), lie within the gap of the tree's; the unknown ones do not."""
    near: Bools = np.isfinite(places.sum(axis=1))
    near[near] = tree.query(places[near])[0] <= GAP_M
    return near


def first_share(part: Bools, recording: Recording, share: float) -> tuple[Bools, Bools]:
    """Return the first ``share`` of a part along the path and what follows after the gap, shape (T,) each.

    Args:
        part: Which intervals belong to the part, shape (T,).
        recording: That it is a part of.
        share: From 0 to 1.
    """
    steps = np.diff(along_path_m(recording.labels_m(LABELS)), prepend=0.0)
    along = np.cumsum(np.where(part, steps, 0.0))
    beyond = along - share * along[-1]
    return part & (beyond < -GAP_M / 2), part & (beyond > GAP_M / 2)


def only(recordings: Sequence[Recording], masks: Sequence[Bools]) -> list[Recording]:
    """Return the recordings with the intervals of ``masks`` alone; those without any are left out."""
    pairs = zip(recordings, masks, strict=True)
    return [recording.where(mask) for recording, mask in pairs if mask.any()]
