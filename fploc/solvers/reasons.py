"""Why an interval cannot be solved, decided in one place for all solvers."""

from __future__ import annotations

import torch
from torch import Tensor

from fploc.intervals import NoFix

FEWEST_RANGES = 3


def reasons_for(heard: Tensor, is_solvable: Tensor) -> Tensor:
    """Return the ``NoFix`` of every interval.

    Args:
        heard: Shape (B, A).
        is_solvable: False where the access points heard do not fix a position, shape (B,).

    Returns:
        Shape (B,), int64.
    """
    count = heard.sum(-1)
    reasons = torch.where(is_solvable, int(NoFix.FIXED), int(NoFix.DEGENERATE_GEOMETRY))
    reasons = torch.where(count < FEWEST_RANGES, int(NoFix.TOO_FEW_RANGES), reasons)
    return torch.where(count == 0, int(NoFix.NO_READING), reasons)
