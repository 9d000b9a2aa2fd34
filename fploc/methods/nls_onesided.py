"""``nls-onesided``: nonlinear least squares with a loss that knows that walls only lengthen ranges (issue 4).

There is no learning in it: one offset and one asymmetric loss. It is the bar under every learned method.
"""

from __future__ import annotations

from fploc.methods.nls_robust import RobustSettings, method_of, read_settings
from fploc.methods.one_shot import OneShotMethod

NAME = "nls-onesided"


def nls_onesided(settings: RobustSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/nls-onesided.yaml."""
    return method_of(NAME, read_settings(NAME) if settings is None else settings)
