"""``nls-onesided``: nonlinear least squares with a loss that knows that walls only lengthen ranges (issue 4).

There is no learning in it: one offset and one asymmetric loss. It is the bar under every learned method.
"""

from __future__ import annotations

from fploc.methods.nls_robust import method_of, read_settings
from fploc.methods.one_shot import OneShotMethod

NAME = "nls-onesided"


def nls_onesided() -> OneShotMethod:
    """Return the method with the settings of conf/method/nls-onesided.yaml."""
    return method_of(NAME, read_settings(NAME))
