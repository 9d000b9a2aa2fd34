"""``lls``: linear least squares on all ranges, the nearest access point as reference (rivals.md, LLS-RS)."""

from __future__ import annotations

from torch import Tensor

from fploc.methods.interface import Estimate
from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.linear import nearest_access_points, solve_linear


def lls() -> OneShotMethod:
    """Return the method."""
    return OneShotMethod("lls", _solve)


def _solve(ranges: Tensor, access_points: Tensor, sigmas: Tensor, heard: Tensor, /) -> Estimate:
    reference = nearest_access_points(ranges, heard)
    return solve_linear(ranges, access_points, sigmas, heard, reference=reference)
