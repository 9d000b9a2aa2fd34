"""``nls-robust``: nonlinear least squares on all ranges with a loss that far residuals pull less (rivals.md)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from fploc.conf import instantiate, read_conf
from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.losses import Loss
from fploc.solvers.nonlinear import NonlinearSettings, solve_nonlinear

NAME = "nls-robust"


@dataclass(frozen=True)
class RobustSettings:
    """Settings of nonlinear least squares with a loss of choice: conf/method/<name>.yaml.

    Args:
        loss: Of residuals over ``sigma_m``.
        sigma_m: As in ``OneShotMethod``.
        sigma_per_m: As in ``OneShotMethod``.
        advantage: As in ``NonlinearSettings``.
        calibration: That it runs with unless asked.
    """

    loss: Loss
    sigma_m: float
    sigma_per_m: float
    advantage: float
    calibration: str


def nls_robust(settings: RobustSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/nls-robust.yaml."""
    return method_of(NAME, read_settings(NAME) if settings is None else settings)


def read_settings(name: str) -> RobustSettings:
    """Return the settings in conf/method/<name>.yaml."""
    return instantiate(RobustSettings, read_conf("method", name), source=f"conf/method/{name}.yaml")


def method_of(name: str, settings: RobustSettings) -> OneShotMethod:
    """Return nonlinear least squares with these settings as the method ``name``."""
    iteration = NonlinearSettings(advantage=settings.advantage)
    return OneShotMethod(
        name,
        partial(solve_nonlinear, loss=settings.loss, settings=iteration),
        settings.calibration,
        sigma_m=settings.sigma_m,
        sigma_per_m=settings.sigma_per_m,
    )
