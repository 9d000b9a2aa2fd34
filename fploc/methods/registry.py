"""Every method by its name.

Methods of pure geometry are made from nothing; learned ones come out of an artifact, which the caller resolves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fploc.errors import UnknownNameError
from fploc.methods.bayes_grid import BayesGrid
from fploc.methods.cbt_wccg import CbtWccg
from fploc.methods.interface import Method
from fploc.methods.lls import lls
from fploc.methods.nls import nls
from fploc.methods.nls_onesided import nls_onesided
from fploc.methods.nls_robust import nls_robust
from fploc.methods.rtt_rss import RttRss
from fploc.methods.trilateration import trilateration

GEOMETRIC_METHODS: Mapping[str, Callable[[], Method]] = {
    "lls": lls,
    "nls": nls,
    "nls-robust": nls_robust,
    "nls-onesided": nls_onesided,
    "trilateration": trilateration,
    "rtt-rss": RttRss,
    "bayes-grid": BayesGrid,
    "cbt-wccg": CbtWccg,
}


def geometric_method(name: str) -> Method:
    """Return the method of this name, which needs no training.

    Raises:
        UnknownNameError: If no such method exists.
    """
    if name not in GEOMETRIC_METHODS:
        raise UnknownNameError(
            "method", name, known=list(GEOMETRIC_METHODS), way_out="choose one of these with `--method`"
        )
    return GEOMETRIC_METHODS[name]()
