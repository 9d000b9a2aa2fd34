"""``lls``: linear least squares on all ranges, the nearest access point as reference (rivals.md, LLS-RS)."""

from __future__ import annotations

from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.linear import solve_linear


def lls() -> OneShotMethod:
    """Return the method."""
    return OneShotMethod("lls", solve_linear)
