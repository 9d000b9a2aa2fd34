"""Losses of a range residual, as a least-squares solver with changing weights needs them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


class Loss(Protocol):
    """A loss ρ of residuals over their standard deviations, s = (|x − p| − d)/σ."""

    def value(self, scaled: Tensor) -> Tensor:
        """Return ρ(s), shape of ``scaled``."""
        ...

    def weight(self, scaled: Tensor) -> Tensor:
        """Return ρ′(s)/s, shape of ``scaled``: the weight of the residual in the next linear system."""
        ...


@dataclass(frozen=True)
class SquaredLoss:
    """ρ(s) = s²/2."""

    def value(self, scaled: Tensor) -> Tensor:
        """Return s²/2."""
        return scaled.square() / 2

    def weight(self, scaled: Tensor) -> Tensor:
        """Return 1."""
        return torch.ones_like(scaled)
