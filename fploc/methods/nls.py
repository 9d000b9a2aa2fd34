"""``nls``: nonlinear least squares on all ranges with the squared loss (rivals.md)."""

from __future__ import annotations

from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.nonlinear import solve_nonlinear


def nls() -> OneShotMethod:
    """Return the method."""
    return OneShotMethod("nls", solve_nonlinear)
