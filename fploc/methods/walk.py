"""How people move, for beliefs on a grid: somebody dawdles on the spot, or walks on in one direction.

A random walk must choose between a belief that lags behind a walker and one that averages nothing for somebody who
stands. So a belief is held for each *gait*: one for dawdling, one for walking in each of some directions. Readings
decide between them, as in an interacting multiple model (Blom and Bar-Shalom, IEEE Transactions on Automatic Control
1988, 33:780), here with cells for Gaussians.

Axes: B devices, G gaits, X and Y cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.methods.belief_grid import along_axes, kernels, reach_of


@dataclass(frozen=True)
class WalkSettings:
    """Settings of the walk.

    Args:
        speed_prior_mps: v: the speed that people are said to walk at, metres per second.
        headings: Directions that are told apart.
        pace: Speed of walking, in units of v.
        unsteady_s: A walker strays from the way ahead by speed² · unsteady_s · dt per axis.
        dawdling_s: Somebody who dawdles strays by v² · dawdling_s · dt per axis.
        keeps_s: Time constant of a gait: after so long, most have taken another.
        walking_share: Share of time that people walk.
    """

    speed_prior_mps: float
    headings: int
    pace: float
    unsteady_s: float
    dawdling_s: float
    keeps_s: float
    walking_share: float


@dataclass(frozen=True)
class Strides:
    """How far a stretch of time takes every gait of a batch of devices.

    Args:
        kernels: Along x and y, in cells, shape (B, G, 2, K).
        shares: Of those who had gait h before, how many have g after, shape (B, G, H).
    """

    kernels: Tensor
    shares: Tensor

    @property
    def reach(self) -> int:
        """Cells that nobody gets beyond."""
        return self.kernels.shape[-1] // 2

    def on(self, shape: tuple[int, int]) -> Transition:
        """Return where they lead on so many cells along x and y."""
        return Transition(*along_axes(self.kernels.float(), shape), self.shares)


@dataclass(frozen=True)
class Transition:
    """Where a stretch of time takes whoever is on a cell.

    Args:
        along_x: From columns to rows, shape (B, G, X, X), float32.
        along_y: From columns to rows, shape (B, G, Y, Y), float32.
        shares: Of those who had gait h before, how many have g after, shape (B, G, H).
    """

    along_x: Tensor
    along_y: Tensor
    shares: Tensor

    def onwards(self, beliefs: Tensor) -> Tensor:
        """Return where everybody is afterwards, from beliefs (B, G, X, Y); what leaves the cells is lost."""
        along_x, along_y = self.along_x.to(beliefs.dtype), self.along_y.to(beliefs.dtype)
        return _exchanged(self.shares, along_x @ beliefs @ along_y.mT)

    def looked_back(self, messages: Tensor) -> Tensor:
        """Return how likely what comes is from each cell and gait: the adjoint of ``onwards``.

        Args:
            messages: How likely what comes is from where somebody is afterwards, shape (B, G, X, Y).
        """
        along_x, along_y = self.along_x.to(messages.dtype), self.along_y.to(messages.dtype)
        return along_x.mT @ _exchanged(self.shares.mT, messages) @ along_y


def _exchanged(shares: Tensor, beliefs: Tensor) -> Tensor:
    """Return sums over gaits of beliefs (B, H, X, Y), weighed by shares (B, G, H)."""
    return (shares.to(beliefs.dtype) @ beliefs.flatten(2)).view(beliefs.shape)


class Walk:
    """Moves beliefs of devices.

    Args:
        settings: Of the walk.
    """

    def __init__(self, settings: WalkSettings) -> None:
        self.settings = settings
        speed = settings.pace * settings.speed_prior_mps
        angles = torch.arange(settings.headings, dtype=torch.float64) * (2 * math.pi / settings.headings)
        walking = speed * torch.stack([angles.cos(), angles.sin()], -1)
        self._velocities = torch.cat([torch.zeros(1, 2, dtype=torch.float64), walking])
        self._speeds = self._velocities.norm(dim=-1)
        strays = settings.unsteady_s * self._speeds.square()
        strays[0] = settings.dawdling_s * settings.speed_prior_mps**2
        self._strays = strays
        self._shares = torch.full_like(self._speeds, settings.walking_share / settings.headings)
        self._shares[0] = 1 - settings.walking_share

    def begun(self, beliefs: Tensor) -> Tensor:
        """Return beliefs of every gait, shape (B, G, X, Y), float32, of somebody who is at ``beliefs`` (B, X, Y)."""
        return (beliefs[:, None] * self._shares[:, None, None]).float()

    def strides(self, dt_s: Tensor, cell_m: float, *, farthest: int) -> Strides:
        """Return where ``dt_s`` (B,) takes everybody.

        Who keeps a gait goes on by v·τ(1 − exp(−dt/τ)): the mean of a walk that is kept for τ; the variance of
        such a walk is added. Others start anew at what people do on average.

        Args:
            dt_s: Shape (B,), seconds.
            cell_m: Side of a cell, metres.
            farthest: Cells of the grid along its longer side.
        """
        keeps_s = self.settings.keeps_s
        kept = torch.exp(-dt_s / keeps_s)
        ahead_s = keeps_s * (1 - kept)
        meanders_s2 = (keeps_s * (dt_s - ahead_s) - ahead_s.square() / 2).clamp(min=0.0)
        shifts = self._velocities * ahead_s[:, None, None] / cell_m
        strayed_m2 = self._speeds.square() * meanders_s2[:, None] + self._strays * dt_s[:, None]
        variances = strayed_m2 / cell_m**2
        reach = min(reach_of(shifts, variances), farthest)
        kept = kept[:, None, None]
        keeping = torch.eye(len(self._shares), dtype=kept.dtype)
        return Strides(
            kernels(shifts, variances[..., None], reach),
            kept * keeping + (1 - kept) * self._shares[:, None],
        )

    def mean_speeds_mps(self, beliefs: Tensor) -> Tensor:
        """Return the mean speed of each device, shape (B,), metres per second, by beliefs (B, G, X, Y)."""
        return beliefs.sum((2, 3)).double() @ self._speeds
