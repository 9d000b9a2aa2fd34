"""``gnn``: the paper's pre-localization as a method of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from fploc.graphs.first_estimates import first_estimates
from fploc.graphs.radio_graph import neighbours, radio_graph
from fploc.intervals import Estimate, Intervals, NoFix, estimate
from fploc.models.gnn import GNN
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site

FEWEST_NEIGHBOURS = 3


def reasons_for_neighbours(intervals: Intervals) -> Tensor:
    """Return ``NoFix`` of each device: a fix needs three neighbours, shape (B,), int64."""
    counts = neighbours(intervals)
    reasons = torch.full_like(counts, int(NoFix.FIXED))
    reasons = torch.where(counts < FEWEST_NEIGHBOURS, int(NoFix.TOO_FEW_RANGES), reasons)
    return torch.where((counts == 0) | ~intervals.present, int(NoFix.NO_READING), reasons)


@dataclass(frozen=True)
class GNNMethod:
    """The GNN on every interval alone. Its state is the access points' positions, shape (A, 2), metres.

    Args:
        network: The trained network, in evaluation mode.
        variance_m2: Variance of a fix per axis, from the validation recordings.
        name: Of the method.
    """

    network: GNN
    variance_m2: float
    name: str = "gnn"
    memoryless: ClassVar[bool] = True

    def init(self, site: Site, devices: int) -> Tensor:
        """Return the access points' positions; they serve any number of devices."""
        return torch.tensor(site.positions_m, dtype=torch.float32)

    @torch.no_grad()
    def step(self, state: Tensor, intervals: Intervals) -> tuple[Tensor, Estimate]:
        """Locate every device from one interval; ranges beyond 60 m count as not heard."""
        intervals = intervals.nearer_than(FARTHEST_RANGE_M)
        access_points = state.to(intervals.ranges.device)
        first = first_estimates(intervals, access_points)
        positions = self.network(radio_graph(intervals, access_points, first)).double()
        covariances = self.variance_m2 * torch.eye(2, dtype=torch.float64, device=positions.device)
        return state, estimate(
            positions, covariances.expand(len(positions), 2, 2), reasons_for_neighbours(intervals)
        )
