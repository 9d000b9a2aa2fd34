"""``trilateration``: the three nearest access points, linear (the paper, commented text; rivals.md)."""

from __future__ import annotations

from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.trilateration import solve_trilateration


def trilateration() -> OneShotMethod:
    """Return the method."""
    return OneShotMethod("trilateration", solve_trilateration)
