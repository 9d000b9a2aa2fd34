"""Cells that beliefs are held on, what the plan says of each, and beliefs' moments.

Axes: B devices, A access points, X and Y cells, C = X · Y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walkable import walkable_shares
from fploc.sites.site import Site


@dataclass(frozen=True)
class BeliefGrid:
    """Cells over the access points' bounding box and a margin.

    Args:
        cell_m: Side of a cell, metres.
        columns: X, number of cells along x.
        rows: Y, number of cells along y.
        cells_m: Centres, shape (C, 2), metres, site frame.
        distances_m: From each access point to each cell, shape (A, C), metres.
        plan_log: Logarithm of how likely the plan alone makes each cell, shape (C,); 0 without a plan.
    """

    cell_m: float
    columns: int
    rows: int
    cells_m: Tensor
    distances_m: Tensor
    plan_log: Tensor

    @classmethod
    def over(cls, site: Site, *, cell_m: float, margin_m: float) -> BeliefGrid:
        """Return the grid of a site, without a plan.

        Args:
            site: The site.
            cell_m: Side of a cell, metres.
            margin_m: Around the access points' bounding box, metres.
        """
        access_points = torch.from_numpy(site.positions_m)
        xs_m, ys_m = (_centres(access_points[:, axis], cell_m, margin_m) for axis in (0, 1))
        cells = torch.cartesian_prod(xs_m, ys_m)
        return cls(
            cell_m=cell_m,
            columns=len(xs_m),
            rows=len(ys_m),
            cells_m=cells,
            distances_m=torch.cdist(access_points, cells),
            plan_log=torch.zeros(len(cells), dtype=torch.float64),
        )

    def weighted_by(self, plan: FloorPlan, site: Site, *, blocked: float) -> BeliefGrid:
        """Return the same cells, weighted by what a plan says of each.

        Args:
            plan: The plan.
            site: Whose access points tell indoors from outdoors.
            blocked: How likely a cell is that nobody can stand on, beside a free one: drawings lie.

        Raises:
            FplocError: If the plan has no free space near any access point.
        """
        shares = walkable_shares(plan, site.positions_m, self.cells_m.numpy(), self.cell_m)
        # A cell that a wall cuts in half is as good as a free one: its free half is.
        likely = torch.from_numpy(shares).mul(2).clamp(max=1.0) + blocked
        return replace(self, plan_log=(likely / (1 + blocked)).log())

    def uniform(self, devices: int) -> Tensor:
        """Return beliefs that favour no cell, shape (B, X, Y)."""
        shape = (devices, self.columns, self.rows)
        return torch.full(shape, 1 / len(self.cells_m), dtype=torch.float64)

    def moments(self, beliefs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means (B, 2), metres, and covariances (B, 2, 2), square metres, of beliefs (B, X, Y)."""
        weights = beliefs.flatten(1)
        means = weights @ self.cells_m
        away = self.cells_m - means[:, None, :]
        covariances = (weights[..., None] * away).mT @ away
        within_cell = torch.eye(2, dtype=torch.float64) * (self.cell_m**2 / 12)
        return means, (covariances + covariances.mT) / 2 + within_cell


def _centres(coordinates: Tensor, cell_m: float, margin_m: float) -> Tensor:
    """Return cell centres that cover access points' coordinates, shape (A,), and the margin."""
    low, high = float(coordinates.min()) - margin_m, float(coordinates.max()) + margin_m
    count = math.ceil((high - low) / cell_m)
    return low + cell_m * (torch.arange(count, dtype=torch.float64) + 0.5)


def posterior(before: Tensor, log_likelihoods: Tensor) -> Tensor:
    """Return beliefs (B, X, Y) times likelihoods, their logarithms (B, C), scaled to sum 1."""
    tiniest = torch.finfo(before.dtype).tiny
    logs = before.flatten(1).clamp(min=tiniest).log() + log_likelihoods
    return torch.softmax(logs, dim=-1).reshape(before.shape)
