"""What the Kalman filter would have said had it known the rest of the recording (Rauch, Tung and Striebel,
AIAA Journal 1965, 3:1445).

Offline only: a live server does not know what comes. The forward pass is the filter's own, with all its judgement of
fixes; the backward pass corrects every state by what the next one turned out to be.

Axes: T time, B devices.
"""

from __future__ import annotations

import torch

from fploc.filters.kalman import BatchedFilter, KalmanState, process_noise, transition
from fploc.intervals import Estimate, Intervals, estimate, stacked


def smoothed(tracker: BatchedFilter, intervals: Intervals, found: Estimate) -> Estimate:
    """Return smoothed estimates, shapes (T, B, …); an interval without a fix stays without one.

    Args:
        tracker: The filter.
        intervals: Of whole recordings, shapes (T, B, …).
        found: The method's fixes, shapes (T, B, …).
    """
    tracks = tracker.init(intervals.t_s.shape[1], device=intervals.t_s.device)
    states = []
    for step in range(len(intervals.t_s)):
        fixes = Estimate(found.positions[step], found.covariances[step], found.reasons[step])
        tracks, _ = tracker.step(tracks, intervals.t_s[step], intervals.present[step], fixes)
        states.append(tracks)
    for step in reversed(range(len(states) - 1)):
        states[step] = _corrected(tracker, states[step], states[step + 1])
    return stacked(
        [
            estimate(one.means[:, :2], one.covariances[:, :2, :2], found.reasons[step])
            for step, one in enumerate(states)
        ]
    )


def _corrected(tracker: BatchedFilter, before: KalmanState, after: KalmanState) -> KalmanState:
    """Return the filtered state ``before`` corrected by the smoothed state ``after``; no track begins earlier."""
    dt_s = after.t_s - before.t_s
    flow = transition(dt_s, tracker.settings.turning_s)
    expected = flow @ before.covariances @ flow.mT + process_noise(dt_s, tracker.settings)
    gain = torch.linalg.solve(expected, flow @ before.covariances).mT
    missed = after.means[..., None] - flow @ before.means[..., None]
    means = before.means + (gain @ missed)[..., 0]
    covariances = before.covariances + gain @ (after.covariances - expected) @ gain.mT
    started = before.started[:, None]
    return KalmanState(
        means=torch.where(started, means, before.means),
        covariances=torch.where(started[..., None], covariances, before.covariances),
        t_s=before.t_s,
        fixed_t_s=before.fixed_t_s,
        started=before.started,
    )
