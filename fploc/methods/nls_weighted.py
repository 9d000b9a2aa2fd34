"""``nls-weighted``: ``nls`` whose ranges weigh less the longer they are, as tuned on the source (rivals.md)."""

from __future__ import annotations

from fploc.methods.nls_robust import RobustSettings, method_of, read_settings
from fploc.methods.one_shot import OneShotMethod

NAME = "nls-weighted"


def nls_weighted(settings: RobustSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/nls-weighted.yaml."""
    return method_of(NAME, read_settings(NAME) if settings is None else settings)
