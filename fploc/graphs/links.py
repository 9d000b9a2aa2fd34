"""An interval as links: the device–AP pairs that networks on crops take one by one."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.methods.interface import Intervals


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
