"""Intervals of a batch of devices, their links, and estimates made from them: what flows between all parts.

Axes: B devices (every recording of every device is one entry of the batch), A access points, L device links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import torch
from torch import Tensor

RSS_AT_1_M_DBM = -40.0
"""About what access points are received with at 1 m."""
REGION_95 = 5.991464547107979
"""95 % quantile of χ² with two degrees of freedom."""


class NoFix(IntEnum):
    """Why an estimate holds no position; ``FIXED`` says that it does."""

    FIXED = 0
    NO_READING = 1
    TOO_FEW_RANGES = 2
    DEGENERATE_GEOMETRY = 3


@dataclass(frozen=True)
class DeviceLinks:
    """Ranges between devices of one batch.

    Args:
        index: Receiving and sending device, shape (2, L), int64.
        ranges: Range, shape (L,), metres.
        rss: Received signal strength, shape (L,), dBm.
    """

    index: Tensor
    ranges: Tensor
    rss: Tensor

    def to(self, device: torch.device | str) -> DeviceLinks:
        """Return the links on ``device``."""
        return DeviceLinks(self.index.to(device), self.ranges.to(device), self.rss.to(device))


@dataclass(frozen=True)
class Intervals:
    """One interval of each device of a batch.

    Args:
        t_s: Device time, shape (B,), seconds.
        ranges: Calibrated range in the plan, shape (B, A), metres; 0 where ``heard`` is False.
        stds: The phone's own spread of each range, shape (B, A), metres; 0 where unknown.
        rss: Received signal strength, shape (B, A), dBm; where unknown, the usual one of such a range; 0 where
            ``heard`` is False.
        heard: True where the access point answered with a range, shape (B, A).
        present: True where the device has an interval at this step, shape (B,): shorter recordings
            end before longer ones. Absent devices keep their state.
        links: Ranges between the devices, or None.
    """

    t_s: Tensor
    ranges: Tensor
    stds: Tensor
    rss: Tensor
    heard: Tensor
    present: Tensor
    links: DeviceLinks | None = None

    def at(self, index: slice | int) -> Intervals:
        """Return those at an index or slice of the first axis, without links."""
        return Intervals(
            t_s=self.t_s[index],
            ranges=self.ranges[index],
            stds=self.stds[index],
            rss=self.rss[index],
            heard=self.heard[index],
            present=self.present[index],
        )

    def nearer_than(self, limit_m: float) -> Intervals:
        """Return the same without ranges beyond ``limit_m``, as if these had not been heard."""
        heard = self.heard & (self.ranges <= limit_m)
        return replace(
            self,
            ranges=torch.where(heard, self.ranges, 0.0),
            stds=torch.where(heard, self.stds, 0.0),
            rss=torch.where(heard, self.rss, 0.0),
            heard=heard,
        )

    def to(self, device: torch.device | str) -> Intervals:
        """Return the intervals on ``device``."""
        return Intervals(
            t_s=self.t_s.to(device),
            ranges=self.ranges.to(device),
            stds=self.stds.to(device),
            rss=self.rss.to(device),
            heard=self.heard.to(device),
            present=self.present.to(device),
            links=None if self.links is None else self.links.to(device),
        )


def usual_rss(ranges: Tensor) -> Tensor:
    """Return the signal strength in free space at ranges of any shape, metres; dBm."""
    return RSS_AT_1_M_DBM - 20.0 * torch.log10(ranges.clamp(min=1.0))


@dataclass(frozen=True)
class Estimate:
    """Positions of a batch of devices.

    Args:
        positions: Shape (B, 2), metres, site frame; NaN where there is no fix.
        covariances: Shape (B, 2, 2), square metres; NaN where there is no fix.
        reasons: ``NoFix`` of each device, shape (B,), int64.
    """

    positions: Tensor
    covariances: Tensor
    reasons: Tensor

    @property
    def fixed(self) -> Tensor:
        """True where there is a position, shape (B,)."""
        return self.reasons == NoFix.FIXED


def estimate(positions: Tensor, covariances: Tensor, reasons: Tensor) -> Estimate:
    """Return an ``Estimate`` whose entries without a fix are NaN, and whose non-finite ones are no fix."""
    finite = torch.isfinite(positions).all(-1) & torch.isfinite(covariances).all((-1, -2))
    reasons = torch.where((reasons == NoFix.FIXED) & ~finite, int(NoFix.DEGENERATE_GEOMETRY), reasons)
    fixed = reasons == NoFix.FIXED
    nan = torch.full((), torch.nan, dtype=positions.dtype, device=positions.device)
    return Estimate(
        positions=torch.where(fixed[:, None], positions, nan),
        covariances=torch.where(fixed[:, None, None], covariances, nan),
        reasons=reasons,
    )


def selected(where: Tensor, one: Estimate, other: Estimate) -> Estimate:
    """Return ``one`` where a device is chosen, shape (B,), else ``other``."""
    return Estimate(
        positions=torch.where(where[:, None], one.positions, other.positions),
        covariances=torch.where(where[:, None, None], one.covariances, other.covariances),
        reasons=torch.where(where, one.reasons, other.reasons),
    )


@dataclass(frozen=True)
class Links:
    """Device–AP pairs of a batch.

    Args:
        device: Index of the device, shape (L,), int64.
        access_points: Position of the access point, shape (L, 2), metres, site frame.
        ranges: Calibrated range in the plan, ζ, shape (L,), metres.
        rss: Received signal strength, γ, shape (L,), dBm.
    """

    device: Tensor
    access_points: Tensor
    ranges: Tensor
    rss: Tensor


def links_of(intervals: Intervals, access_points: Tensor) -> Links:
    """Return the links of B devices that heard A access points at ``access_points`` (A, 2), metres."""
    device, access_point = torch.nonzero(intervals.heard, as_tuple=True)
    return Links(
        device=device,
        access_points=access_points[access_point],
        ranges=intervals.ranges[device, access_point],
        rss=intervals.rss[device, access_point],
    )


def stacked(estimates: Sequence[Estimate]) -> Estimate:
    """Return estimates of one interval each as one with a leading time axis."""
    return Estimate(
        positions=torch.stack([one.positions for one in estimates]),
        covariances=torch.stack([one.covariances for one in estimates]),
        reasons=torch.stack([one.reasons for one in estimates]),
    )
