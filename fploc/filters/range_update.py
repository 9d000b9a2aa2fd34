"""Ranges that enter the Kalman filter themselves, beside fixes or where there is none.

A range to a known place is a measurement of the track: with h(x) = |x − p| and its slope u = (x − p)/|x − p|
at the prediction, an extended Kalman update takes all ranges of an interval together. One or two ranges then tell
something, and of two places that fit them equally well the track knows the right one, which no solver that sees a
single interval does. As for fixes, a range beyond three standard deviations is believed the less the farther it is,
and ranges that follow one another within a correlation time count as one.

Axes: B devices, K ranges of each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.filters.kalman import SHORTEST_STEP_S, BatchedFilter, KalmanSettings, KalmanState
from fploc.intervals import Estimate, NoFix, estimate

SHORTEST_DISTANCE_M = 0.1
"""Nearer to a place the direction from it is not known, and its range tells nothing of the position."""


@dataclass(frozen=True)
class Ranges:
    """Ranges of a batch of devices to known places.

    Args:
        anchors: Places, shape (B, K, 2), metres, site frame.
        ranges: Shape (B, K), metres.
        variances: Of the ranges, shape (B, K), square metres.
        anchor_covariances: Of the places, shape (B, K, 2, 2), square metres.
        there: True where there is such a range, shape (B, K).
    """

    anchors: Tensor
    ranges: Tensor
    variances: Tensor
    anchor_covariances: Tensor
    there: Tensor


@dataclass(frozen=True)
class RangedState:
    """Tracks of a batch of devices, and the time of the last ranges in each, shape (B,), seconds."""

    tracks: KalmanState
    ranged_t_s: Tensor


class RangedFilter:
    """The Kalman filter on fixes that also takes ranges.

    Args:
        settings: Of the filter; the gate holds for ranges too.
        correlation_s: For so long the errors of successive ranges are one error: walls do not move.
    """

    def __init__(self, settings: KalmanSettings, correlation_s: float) -> None:
        self.settings = settings
        self.correlation_s = correlation_s
        self.fixes = BatchedFilter(settings)

    def init(self, devices: int, *, device: torch.device | str = "cpu") -> RangedState:
        """Return the state of ``devices`` tracks before their first fix."""
        tracks = self.fixes.init(devices, device=device)
        never = torch.full((devices,), -torch.inf, dtype=torch.float64, device=device)
        return RangedState(tracks, never)

    def step(
        self, state: RangedState, t_s: Tensor, present: Tensor, fixes: Estimate, ranges: Ranges
    ) -> tuple[RangedState, Estimate]:
        """Advance every device that is present by one interval: by its fix, then by its ranges.

        Args:
            state: Of the tracks.
            t_s: Time of the interval, shape (B,), seconds.
            present: True where the device has an interval, shape (B,); others keep their state.
            fixes: What the method found.
            ranges: Further ranges. A track starts at its first fix, never at a range.

        Returns:
            The new state and the filtered estimate: it is a fix where a fix or a range entered.
        """
        tracks, filtered = self.fixes.step(state.tracks, t_s, present, fixes)
        there = ranges.there & (present & tracks.started)[:, None]
        updated = self._updated(tracks, replace(ranges, there=there), state.ranged_t_s)
        entered = there.any(-1)
        reasons = torch.where(entered, int(NoFix.FIXED), filtered.reasons)
        new = RangedState(updated, torch.where(entered, tracks.t_s, state.ranged_t_s))
        return new, estimate(updated.means[:, :2], updated.covariances[:, :2, :2], reasons)

    def _updated(self, tracks: KalmanState, given: Ranges, ranged_t_s: Tensor) -> KalmanState:
        """Return the tracks after an extended Kalman update by all ranges together."""
        away = tracks.means[:, None, :2] - given.anchors
        distances = away.norm(dim=-1)
        there = given.there & (distances >= SHORTEST_DISTANCE_M)
        directions = (
            torch.where(there[..., None], away, 0.0) / distances.clamp(min=SHORTEST_DISTANCE_M)[..., None]
        )
        slopes = torch.nn.functional.pad(directions, (0, 2))
        innovations = torch.where(there, given.ranges - distances, 0.0)
        known = (directions[..., None, :] @ given.anchor_covariances @ directions[..., None])[..., 0, 0]
        since_s = (tracks.t_s - ranged_t_s).clamp(min=SHORTEST_STEP_S)
        crowding = (self.correlation_s / since_s).clamp(min=1.0)[:, None]
        noise = torch.where(there, (given.variances + known) * crowding, 1.0)
        predicted = slopes @ tracks.covariances @ slopes.mT
        spread = predicted.diagonal(dim1=-2, dim2=-1) + noise
        noise = noise * (innovations.square() / spread / self.settings.gate).clamp(min=1.0)
        shared = tracks.covariances @ slopes.mT
        gain = torch.linalg.solve(predicted + torch.diag_embed(noise), shared.mT).mT
        kept = torch.eye(4, dtype=gain.dtype, device=gain.device) - gain @ slopes
        return replace(
            tracks,
            means=tracks.means + (gain @ innovations[..., None])[..., 0],
            covariances=kept @ tracks.covariances @ kept.mT + (gain * noise[:, None, :]) @ gain.mT,
        )
