"""First node feature of a device: trilateration, kept near the access points."""

from __future__ import annotations

import torch
from torch import Tensor

from fploc.intervals import Intervals
from fploc.solvers.trilateration import solve_trilateration

MARGIN_M = 5.0


def first_estimates(intervals: Intervals, access_points: Tensor) -> Tensor:
    """Return a first position of each device, shape (B, 2), metres, site frame.

    Trilateration (paper, section "Graph Representation"), limited to the bounding box of the access points
    widened by 5 m, since near-singular triples throw it far out. Where it gives no position (fewer than
    three ranges), the mean of the heard access points weighted by one over their range.

    Args:
        intervals: One interval of each device.
        access_points: Shape (A, 2), metres, site frame.
    """
    double = access_points.double()
    ranges = intervals.ranges.double()
    solved = solve_trilateration(ranges, double, torch.ones_like(ranges), intervals.heard)
    low, high = double.amin(0) - MARGIN_M, double.amax(0) + MARGIN_M
    trilaterated = torch.minimum(torch.maximum(solved.positions, low), high)
    weights = intervals.heard / ranges.clamp(min=1.0)
    centres = (weights @ double) / weights.sum(-1, keepdim=True).clamp(min=1e-9)
    centres = torch.where(intervals.heard.any(-1, keepdim=True), centres, double.mean(0))
    return torch.where(solved.fixed[:, None], trilaterated, centres).to(access_points.dtype)
