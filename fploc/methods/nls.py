"""``nls``: nonlinear least squares on all ranges alike, with the squared loss (rivals.md)."""

from __future__ import annotations

from fploc.methods.nls_robust import RobustSettings, method_of, read_settings
from fploc.methods.one_shot import OneShotMethod

NAME = "nls"


def nls(settings: RobustSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/nls.yaml."""
    return method_of(NAME, read_settings(NAME) if settings is None else settings)
