"""Cells that beliefs are held on, what the plan says of each, and what becomes of beliefs: moves, product, moments.

Axes: B devices, G beliefs of a device, A access points, X and Y cells, x and y those of a window, C = X · Y or x · y,
K taps of a kernel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor, nn

from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.sight import behind_walls
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
        walled: 1 where walls stand between an access point and a cell, shape (A, C), int32; 0 without a plan.
    """

    cell_m: float
    xs_m: Tensor
    ys_m: Tensor
    cells_m: Tensor
    distances_m: Tensor
    plan_log: Tensor
    walled: Tensor

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
            walled=torch.zeros(len(access_points), len(cells), dtype=torch.int32),
        )

    def on(self, plan: FloorPlan, site: Site, *, blocked: float) -> BeliefGrid:
        """Return the same cells with what a plan says of each.

        Args:
            plan: The plan.
            site: Its access points tell indoors from outdoors, and see cells or do not.
            blocked: How likely a cell is that nobody can stand on, beside a free one: drawings lie.

        Raises:
            FplocError: If the plan has no free space near any access point.
        """
        shares = walkable_shares(plan, site.positions_m, self.cells_m.numpy(), self.cell_m)
        # A cell that a wall cuts in half is as good as a free one: its free half is.
        likely = torch.from_numpy(shares).mul(2).clamp(max=1.0) + blocked
        walled = behind_walls(plan, site.positions_m[:, None], self.cells_m.numpy())
        return replace(self, plan_log=(likely / (1 + blocked)).log(), walled=torch.from_numpy(walled).int())

    def uniform(self, devices: int) -> Tensor:
        """Return beliefs that favour no cell, shape (B, X, Y)."""
        shape = (devices, len(self.xs_m), len(self.ys_m))
        return torch.full(shape, 1 / len(self.cells_m), dtype=torch.float64)

    def moments(self, beliefs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means (B, 2), metres, and covariances (B, 2, 2), square metres, of beliefs (B, X, Y)."""
        return _moments(beliefs, self.xs_m, self.ys_m, self.cell_m)


@dataclass(frozen=True)
class Window:
    """A rectangle of cells for each device of a batch, all of one size: beliefs are 0 on most cells of a building.

    Args:
        grid: Cells of the site.
        first_x: Index of the first cell along x, shape (B,).
        first_y: Index of the first cell along y, shape (B,).
        shape: Cells along x and y.
    """

    grid: BeliefGrid
    first_x: Tensor
    first_y: Tensor
    shape: tuple[int, int]

    @classmethod
    def whole(cls, grid: BeliefGrid, devices: int) -> Window:
        """Return all cells of a grid."""
        first = torch.zeros(devices, dtype=torch.int64)
        return cls(grid, first, first, (len(grid.xs_m), len(grid.ys_m)))

    @cached_property
    def rows(self) -> Tensor:
        """Index along x of each row, shape (B, x)."""
        return self.first_x[:, None] + torch.arange(self.shape[0])

    @cached_property
    def columns(self) -> Tensor:
        """Index along y of each column, shape (B, y)."""
        return self.first_y[:, None] + torch.arange(self.shape[1])

    @cached_property
    def cells(self) -> Tensor:
        """Index of each cell in the grid, shape (B, C)."""
        return (self.rows[:, :, None] * len(self.grid.ys_m) + self.columns[:, None, :]).flatten(1)

    @property
    def distances_m(self) -> Tensor:
        """From each access point to each cell, shape (B, A, C), metres."""
        return self._of_links(self.grid.distances_m)

    @property
    def walled(self) -> Tensor:
        """As that of the grid, shape (B, A, C)."""
        return self._of_links(self.grid.walled)

    @property
    def plan_log(self) -> Tensor:
        """As that of the grid, shape (B, C)."""
        return self.grid.plan_log[self.cells]

    def _of_links(self, values: Tensor) -> Tensor:
        """Return what these cells have of values of the grid (A, C'), shape (B, A, C)."""
        chosen = values.index_select(1, self.cells.flatten())
        return chosen.unflatten(1, self.cells.shape).transpose(0, 1).contiguous()

    def around(self, beliefs: Sequence[Tensor], reach: int) -> Window:
        """Return for each device the cells that any of its beliefs is not 0 on, and ``reach`` more on every side.

        Args:
            beliefs: Of the same devices on these cells, shape (B, G, x, y) each.
            reach: Cells.
        """
        occupied = torch.stack([one.amax(1) for one in beliefs]).amax(0) > 0
        grid = self.grid
        first_x, length_x = _stretch(occupied.any(2), self.first_x, reach, len(grid.xs_m))
        first_y, length_y = _stretch(occupied.any(1), self.first_y, reach, len(grid.ys_m))
        return Window(grid, first_x, first_y, (length_x, length_y))

    def cut(self, beliefs: Tensor, of: Window) -> Tensor:
        """Return what these cells have of beliefs on those ``of`` another window; cells beyond it have 0.

        Args:
            beliefs: Shape (B, G, x', y').
            of: Of the same devices.

        Returns:
            Shape (B, G, x, y).
        """
        x, is_in_x = _found(self.rows - of.first_x[:, None], beliefs.shape[2])
        y, is_in_y = _found(self.columns - of.first_y[:, None], beliefs.shape[3])
        at = (x[:, :, None] * beliefs.shape[3] + y[:, None, :]).flatten(1)
        values = beliefs.flatten(2).gather(2, at[:, None].expand(-1, beliefs.shape[1], -1))
        return values.unflatten(2, self.shape) * (is_in_x[:, :, None] & is_in_y[:, None, :])[:, None]

    def moments(self, beliefs: Tensor) -> tuple[Tensor, Tensor]:
        """Return means (B, 2), metres, and covariances (B, 2, 2), square metres, of beliefs (B, x, y)."""
        xs_m, ys_m = self.grid.xs_m[self.rows], self.grid.ys_m[self.columns]
        return _moments(beliefs, xs_m, ys_m, self.grid.cell_m)


def _centres(coordinates: Tensor, cell_m: float, margin_m: float) -> Tensor:
    """Return cell centres that cover access points' coordinates, shape (A,), and the margin."""
    low, high = float(coordinates.min()) - margin_m, float(coordinates.max()) + margin_m
    count = math.ceil((high - low) / cell_m)
    return low + cell_m * (torch.arange(count, dtype=torch.float64) + 0.5)


def _stretch(occupied: Tensor, first: Tensor, reach: int, cells: int) -> tuple[Tensor, int]:
    """Return the first cell (B,) and the common length of stretches with all occupied cells and a margin.

    Args:
        occupied: Shape (B, n).
        first: Index of the first of these n, shape (B,).
        reach: The margin.
        cells: Of the grid.
    """
    first_in = occupied.int().argmax(1)
    last_in = occupied.shape[1] - 1 - occupied.flip(1).int().argmax(1)
    length = min(cells, int((last_in - first_in).max()) + 1 + 2 * reach)
    return (first + first_in - reach).clamp(0, cells - length), length


def _found(indices: Tensor, length: int) -> tuple[Tensor, Tensor]:
    """Return indices brought into 0 … length − 1, and which were there before."""
    return indices.clamp(0, length - 1), (indices >= 0) & (indices < length)


def _moments(beliefs: Tensor, xs_m: Tensor, ys_m: Tensor, cell_m: float) -> tuple[Tensor, Tensor]:
    """Return means (B, 2) and covariances (B, 2, 2) of beliefs (B, X, Y) on centres (X,), (Y,) or (B, X), (B, Y)."""
    over_x, over_y = beliefs.sum(2), beliefs.sum(1)
    mean_x, mean_y = (over_x * xs_m).sum(1), (over_y * ys_m).sum(1)
    away_x, away_y = xs_m - mean_x[:, None], ys_m - mean_y[:, None]
    within_cell = cell_m**2 / 12
    variance_x = (over_x * away_x.square()).sum(1) + within_cell
    variance_y = (over_y * away_y.square()).sum(1) + within_cell
    shared = ((beliefs @ away_y[..., None])[..., 0] * away_x).sum(1)
    rows = [torch.stack([variance_x, shared], -1), torch.stack([shared, variance_y], -1)]
    return torch.stack([mean_x, mean_y], -1), torch.stack(rows, -2)


def posterior(before: Tensor, log_likelihoods: Tensor) -> Tensor:
    """Return beliefs times likelihoods, scaled to sum 1; negligible cells become 0.

    Args:
        before: Shape (B, G, X, Y).
        log_likelihoods: Of each cell, whatever the belief, shape (B, C).
    """
    weights = likelihood_ratios(log_likelihoods).to(before.dtype)
    after = before.sum(1).flatten(1) * weights
    decides = after >= NEGLIGIBLE * after.amax(1, keepdim=True)
    scaled = decides * weights / (decides * after).sum(1, keepdim=True)
    return before * scaled.unflatten(1, before.shape[2:])[:, None]


def likelihood_ratios(log_likelihoods: Tensor) -> Tensor:
    """Return likelihoods beside the greatest one of each device, from their logarithms, shape (B, C)."""
    highest = log_likelihoods.amax(1, keepdim=True)
    return torch.exp(log_likelihoods - highest).clamp(min=LEAST_WEIGHT)


def tempered(since_s: Tensor, correlation_s: float) -> Tensor:
    """Return the power of a likelihood, shape (B,), so long after the last one whose errors are still the same."""
    return (since_s / max(correlation_s, SHORTEST_S)).clamp(max=1.0)


def reach_of(shifts: Tensor, variances: Tensor) -> int:
    """Return how many cells away ``moved`` gets with these arguments."""
    return math.ceil(KERNEL_REACH * float(variances.max().sqrt()) + float(shifts.abs().max())) + 1


def moved(beliefs: Tensor, shifts: Tensor, variances: Tensor) -> Tensor:
    """Shift beliefs and blur them; what leaves the grid is lost.

    Args:
        beliefs: Shape (B, G, X, Y).
        shifts: Along x and y, shape (B, G, 2), cells.
        variances: Of the blur along each axis, shape (B, G), square cells.

    Returns:
        Shape (B, G, X, Y), of the type of ``beliefs``.
    """
    reach = min(reach_of(shifts, variances), max(beliefs.shape[2:]))
    taps = kernels(shifts, variances[..., None], reach).to(beliefs.dtype)
    # As products of matrices: a convolution for each of many small images takes three times as long.
    along_x, along_y = along_axes(taps, beliefs.shape[2:])
    return along_x @ beliefs @ along_y.mT


def along_axes(taps: Tensor, shape: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return matrices (B, G, X, X) and (B, G, Y, Y) that convolve X and Y cells with kernels (B, G, 2, K)."""
    return banded(taps[:, :, 0], shape[0]), banded(taps[:, :, 1], shape[1])


def banded(taps: Tensor, cells: int) -> Tensor:
    """Return matrices (…, n, n) that convolve ``cells`` values with kernels (…, K); beyond the ends is nothing."""
    reach = taps.shape[-1] // 2
    at = torch.arange(cells)
    offsets = (at[:, None] - at).clamp(-reach - 1, reach + 1) + reach + 1
    return nn.functional.pad(taps, (1, 1)).index_select(-1, offsets.flatten()).unflatten(-1, (cells, cells))


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
