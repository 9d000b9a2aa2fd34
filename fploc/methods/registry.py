"""Every method by its name.

Methods of pure geometry are made from nothing, and some others learn from source recordings within a minute; both
take their settings from conf/method/. Learned ones come out of an artifact, which the caller resolves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fploc.conf import instantiate, read_conf
from fploc.errors import UnknownNameError
from fploc.methods.bayes_grid import BayesGrid, BayesGridSettings
from fploc.methods.cbt_wccg import CbtWccg, CbtWccgSettings
from fploc.methods.fingerprints import Knn, KnnSettings
from fploc.methods.gbm import Gbm, GbmSettings
from fploc.methods.interface import Calibrated, Method, SourceFitted
from fploc.methods.learned_grid import LearnedGrid, LearnedGridSettings
from fploc.methods.lls import LlsSettings, lls
from fploc.methods.nls import nls
from fploc.methods.nls_onesided import nls_onesided
from fploc.methods.nls_robust import RobustSettings, nls_robust
from fploc.methods.nls_weighted import nls_weighted
from fploc.methods.rtt_rss import RttRss, RttRssSettings
from fploc.methods.trilateration import ThreeNearestSettings, trilateration


@dataclass(frozen=True)
class MethodParts:
    """How a method is made from its settings.

    Args:
        settings: Class that conf/method/<name>.yaml describes.
        make: Makes the method from them.
    """

    settings: type[Any]
    make: Callable[[Any], Any]


GEOMETRIC_PARTS: Mapping[str, MethodParts] = {
    "lls": MethodParts(LlsSettings, lls),
    "nls": MethodParts(RobustSettings, nls),
    "nls-weighted": MethodParts(RobustSettings, nls_weighted),
    "nls-robust": MethodParts(RobustSettings, nls_robust),
    "nls-onesided": MethodParts(RobustSettings, nls_onesided),
    "trilateration": MethodParts(ThreeNearestSettings, trilateration),
    "rtt-rss": MethodParts(RttRssSettings, RttRss),
    "bayes-grid": MethodParts(BayesGridSettings, BayesGrid),
    "cbt-wccg": MethodParts(CbtWccgSettings, CbtWccg),
}
SOURCE_FITTED_PARTS: Mapping[str, MethodParts] = {
    "knn": MethodParts(KnnSettings, Knn),
    "gbm": MethodParts(GbmSettings, Gbm),
    "learned-grid": MethodParts(LearnedGridSettings, LearnedGrid),
}
RIVAL_PARTS: Mapping[str, MethodParts] = {**GEOMETRIC_PARTS, **SOURCE_FITTED_PARTS}


def made(name: str, description: Mapping[str, Any]) -> Any:
    """Return the method of ``RIVAL_PARTS`` that a description of its settings makes.

    Raises:
        BadFileError: If the description does not fit.
    """
    parts = RIVAL_PARTS[name]
    settings = instantiate(parts.settings, dict(description), source=f"conf/method/{name}.yaml")
    return parts.make(settings)


def _from_conf(name: str) -> Any:
    return made(name, read_conf("method", name))


GEOMETRIC_METHODS: Mapping[str, Callable[[], Method]] = {
    name: partial(_from_conf, name) for name in GEOMETRIC_PARTS
}
SOURCE_FITTED_METHODS: Mapping[str, Callable[[], SourceFitted]] = {
    name: partial(_from_conf, name) for name in SOURCE_FITTED_PARTS
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


def default_calibration(name: str) -> str:
    """Return the calibration that a method of conf/method/ runs with unless asked.

    Raises:
        UnknownNameError: If no such method exists.
    """
    if name not in RIVAL_PARTS:
        raise UnknownNameError("method", name, known=list(RIVAL_PARTS), way_out="choose one of these")
    method: Calibrated = _from_conf(name)
    return method.default_calibration
