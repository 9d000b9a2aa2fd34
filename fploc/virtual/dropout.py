"""How often a link gives a range at all: the source's rate by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

BIN_WIDTH_M = 5.0


@dataclass(frozen=True)
class Dropout:
    """Share of links heard in each bin of 5 m; the last bin holds everything beyond.

    Args:
        heard_shares: From 0 to 1, one for each bin.
    """

    heard_shares: tuple[float, ...]

    @classmethod
    def fit(cls, distances_m: NDArray[np.float64], heard: NDArray[np.bool_]) -> Dropout:
        """Return the shares among links of known ``distances_m`` (…) that were ``heard`` (…) or not."""
        bins = (distances_m.ravel() / BIN_WIDTH_M).astype(np.int64)
        number = np.bincount(bins)
        answered = np.bincount(bins, weights=heard.ravel())
        shares = np.divide(answered, number, out=np.zeros(len(number)), where=number > 0)
        return cls(heard_shares=tuple(float(share) for share in shares))

    def sample(self, distances: Tensor, generator: torch.Generator) -> Tensor:
        """Return which links of ``distances`` (…), metres, are heard, same shape."""
        shares = torch.tensor(self.heard_shares, device=distances.device)
        bins = (distances / BIN_WIDTH_M).long().clamp(max=len(shares) - 1)
        return torch.rand(distances.shape, generator=generator, device=distances.device) < shares[bins]
