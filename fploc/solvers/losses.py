"""Losses of a range residual, as a least-squares solver with changing weights needs them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor


@runtime_checkable
class Loss(Protocol):
    """A loss ρ of residuals over their standard deviations, s = (|x − p| − d)/σ."""

    def value(self, scaled: Tensor) -> Tensor:
        """Return ρ(s), shape of ``scaled``."""

    def weight(self, scaled: Tensor) -> Tensor:
        """Return ρ′(s)/s, shape of ``scaled``: the weight of the residual in the next linear system."""

    def curvature(self, scaled: Tensor) -> Tensor:
        """Return ρ″(s), shape of ``scaled``: what Newton's steps take in place of the weight."""


@dataclass(frozen=True)
class SquaredLoss:
    """ρ(s) = s²/2."""

    def value(self, scaled: Tensor) -> Tensor:
        """Return s²/2."""
        return scaled.square() / 2

    def weight(self, scaled: Tensor) -> Tensor:
        """Return 1."""
        return torch.ones_like(scaled)

    def curvature(self, scaled: Tensor) -> Tensor:
        """Return 1."""
        return torch.ones_like(scaled)


@dataclass(frozen=True)
class SoftL1Loss:
    """ρ(s) = c² (√(1 + (s/c)²) − 1): squared near 0, c|s| far from it.

    Args:
        scale: c, in standard deviations.
    """

    scale: float

    def value(self, scaled: Tensor) -> Tensor:
        """Return c² (√(1 + (s/c)²) − 1), in a form that keeps its digits near 0."""
        return scaled.square() / ((scaled / self.scale).square().add(1).sqrt() + 1)

    def weight(self, scaled: Tensor) -> Tensor:
        """Return 1/√(1 + (s/c)²)."""
        return (scaled / self.scale).square().add(1).rsqrt()

    def curvature(self, scaled: Tensor) -> Tensor:
        """Return (1 + (s/c)²)^(−3/2)."""
        return self.weight(scaled).pow(3)


@dataclass(frozen=True)
class CauchyLoss:
    """ρ(s) = c²/2 log(1 + (s/c)²): squared near 0, and a far residual pulls the less the farther it is.

    Args:
        scale: c, in standard deviations.
    """

    scale: float

    def value(self, scaled: Tensor) -> Tensor:
        """Return c²/2 log(1 + (s/c)²)."""
        return self.scale**2 / 2 * (scaled / self.scale).square().log1p()

    def weight(self, scaled: Tensor) -> Tensor:
        """Return 1/(1 + (s/c)²)."""
        return 1 / (scaled / self.scale).square().add(1)

    def curvature(self, scaled: Tensor) -> Tensor:
        """Return (1 − (s/c)²)/(1 + (s/c)²)²; negative beyond c."""
        return (1 - (scaled / self.scale).square()) * self.weight(scaled).square()


@dataclass(frozen=True)
class OneSidedLoss:
    """A loss that knows that walls only lengthen ranges.

    A range longer than the distance (s < 0) is forgiven like ``SoftL1Loss``; one shorter than the distance
    (s > 0) can come from no wall and costs ``short_weight`` · s²/2.

    Args:
        short_weight: Weight of a range that is too short.
        long_scale: c of the soft l1 for ranges that are too long, in standard deviations.
    """

    short_weight: float
    long_scale: float

    def value(self, scaled: Tensor) -> Tensor:
        """Return ρ(s)."""
        short = self.short_weight * scaled.square() / 2
        return torch.where(scaled > 0, short, SoftL1Loss(self.long_scale).value(scaled))

    def weight(self, scaled: Tensor) -> Tensor:
        """Return ρ′(s)/s; at 0 that of a range that is too long."""
        return torch.where(scaled > 0, self.short_weight, SoftL1Loss(self.long_scale).weight(scaled))

    def curvature(self, scaled: Tensor) -> Tensor:
        """Return ρ″(s); at 0, where it jumps, that of a range that is too long."""
        return torch.where(scaled > 0, self.short_weight, SoftL1Loss(self.long_scale).curvature(scaled))
