"""Cells that beliefs are held on, what the plan says of each, and what becomes of beliefs: moves, product, moments.

Axes: B devices, G beliefs of a device, A access points, X and Y cells, C = X · Y, K taps of a kernel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walkable import walkable_shares
from fploc.sites.site import Site

SHORTEST_S = 1e-6
KERNEL_REACH = 4.0
"""Cells beyond so many standard deviations get nothing of a blur."""
NEGLIGIBLE = 1e-6
"""Beside the likeliest cell, this is nothing: what distant cells keep takes room in a store and decides nothing."""
LEAST_WEIGHT = 1e-20
"""No interval makes a cell less likely than this, beside the likeliest."""


@dataclass(frozen=True)
class BeliefGrid:
    """Cells over the access points' bounding box and a margin.

    Args:
        cell_m: Side of a cell, metres.
        xs_m: Centres along x, shape (X,), metres, site frame.
        ys_m: Centres along y, shape (Y,), metres, site frame.
        cells_m: Centres, shape (C, 2), metres, site frame.
        distances_m: From each access point to each cell, shape (A, C), metres.
        plan_log: Logarithm of how likely the plan alone makes each cell, shape (C,); 0 without a plan.
    """

    cell_m: float
    xs_m: Tensor
    ys_m: Tensor
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
            xs_m=xs_m,
            ys_m=ys_m,
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
        shape = (devices, len(self.xs_m), len(self.ys_m))
        return torch.full(shape, 1 / len(self.cells_m), dtype=torch.float64)

    def moments(self, beliefs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means (B, 2), metres, and covariances (B, 2, 2), square metres, of beliefs (B, X, Y)."""
        over_x, over_y = beliefs.sum(2), beliefs.sum(1)
        mean_x, mean_y = over_x @ self.xs_m, over_y @ self.ys_m
        away_x, away_y = self.xs_m - mean_x[:, None], self.ys_m - mean_y[:, None]
        within_cell = self.cell_m**2 / 12
        variance_x = (over_x * away_x.square()).sum(1) + within_cell
        variance_y = (over_y * away_y.square()).sum(1) + within_cell
        shared = torch.einsum("bxy,bx,by->b", beliefs, away_x, away_y)
        rows = [torch.stack([variance_x, shared], -1), torch.stack([shared, variance_y], -1)]
        return torch.stack([mean_x, mean_y], -1), torch.stack(rows, -2)


def _centres(coordinates: Tensor, cell_m: float, margin_m: float) -> Tensor:
    """Return cell centres that cover access points' coordinates, shape (A,), and the margin."""
    low, high = float(coordinates.min()) - margin_m, float(coordinates.max()) + margin_m
    count = math.ceil((high - low) / cell_m)
    return low + cell_m * (torch.arange(count, dtype=torch.float64) + 0.5)


def posterior(before: Tensor, log_likelihoods: Tensor) -> Tensor:
    """Return beliefs times likelihoods, scaled to sum 1; negligible cells become 0.

    Args:
        before: Shape (B, G, X, Y).
        log_likelihoods: Of each cell, whatever the belief, shape (B, C).
    """
    after = weighted(before, log_likelihoods)
    after = torch.where(after < NEGLIGIBLE * after.amax((1, 2, 3), keepdim=True), 0.0, after)
    return after / after.sum((1, 2, 3), keepdim=True)


def weighted(before: Tensor, log_likelihoods: Tensor) -> Tensor:
    """Return beliefs (B, G, X, Y) times likelihoods (B, C), the greatest of which counts as 1."""
    highest = log_likelihoods.amax(1, keepdim=True)
    weights = torch.exp(log_likelihoods - highest).clamp(min=LEAST_WEIGHT).to(before.dtype)
    return before * weights.view(len(before), 1, *before.shape[2:])


def tempered(since_s: Tensor, correlation_s: float) -> Tensor:
    """Return the power of a likelihood, shape (B,), so long after the last one whose errors are still the same."""
    return (since_s / max(correlation_s, SHORTEST_S)).clamp(max=1.0)


def moved(beliefs: Tensor, shifts: Tensor, variances: Tensor) -> Tensor:
    """Shift beliefs and blur them, along x and then along y; what leaves the grid is lost.

    Args:
        beliefs: Shape (B, G, X, Y).
        shifts: Along x and y, shape (B, G, 2), cells.
        variances: Of the blur along each axis, shape (B, G), square cells.

    Returns:
        Shape (B, G, X, Y), of the type of ``beliefs``.
    """
    devices, each, rows, columns = beliefs.shape
    reach = math.ceil(KERNEL_REACH * float(variances.max().sqrt()) + float(shifts.abs().max())) + 1
    reach = min(reach, max(rows, columns))
    taps = kernels(shifts, variances[..., None], reach).to(beliefs.dtype).flatten(0, 1)
    # A convolution of torch is a correlation: kernels turned around.
    along_x, along_y = taps[:, 0].flip(-1)[:, None, :, None], taps[:, 1].flip(-1)[:, None, None, :]
    stacked = beliefs.reshape(1, devices * each, rows, columns)
    stacked = torch.nn.functional.conv2d(stacked, along_x, padding=(reach, 0), groups=devices * each)
    stacked = torch.nn.functional.conv2d(stacked, along_y, padding=(0, reach), groups=devices * each)
    return stacked.view(beliefs.shape)


def kernels(shifts: Tensor, variances: Tensor, reach: int) -> Tensor:
    """Return kernels on cells with a mean and a variance that need not be whole, shape (…, K = 2 · reach + 1).

    Each is a whole shift, a share f that goes one cell further, and the Gaussian of a grid, which has the transfer
    function exp(σ² (cos θ − 1)) and the variance σ² however small σ is, where a sampled Gaussian would stand still
    (Lindeberg, IEEE PAMI 1990, 12:234). A variance below f(1 − f), that of the shift itself, cannot be had.

    Args:
        shifts: Means, shape (…), cells.
        variances: Shape (…) or one that broadcasts to it, square cells.
        reach: Of the kernels to either side, cells.
    """
    taps = 2 * reach + 1
    angles = 2 * torch.pi * torch.arange(reach + 1, dtype=shifts.dtype, device=shifts.device) / taps
    shifts = shifts.clamp(-reach, reach)
    share = (shifts - shifts.floor())[..., None]
    rest = (variances[..., None] - share * (1 - share)).clamp(min=0.0)
    further = 1 - share + share * torch.polar(torch.ones_like(angles), -angles)
    turned = -angles * shifts.floor()[..., None]
    transfer = further * torch.polar(torch.exp(rest * (angles.cos() - 1)), turned)
    return torch.fft.irfft(transfer, n=taps).clamp(min=0.0).roll(reach, dims=-1)
