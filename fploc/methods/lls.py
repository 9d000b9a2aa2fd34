"""``lls``: linear least squares on all ranges, weighted, the nearest access point as reference (rivals.md)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from fploc.conf import instantiate, read_conf
from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.linear import LinearSettings, solve_weighted_linear

NAME = "lls"


@dataclass(frozen=True)
class LlsSettings:
    """Settings of linear least squares: conf/method/lls.yaml.

    Args:
        sigma_m: As in ``OneShotMethod``.
        sigma_per_m: As in ``OneShotMethod``.
        smallest_spread_ratio: As in ``LinearSettings``.
        reach_m: As in ``LinearSettings``.
        calibration: That it runs with unless asked.
    """

    sigma_m: float
    sigma_per_m: float
    smallest_spread_ratio: float
    reach_m: float
    calibration: str

    @classmethod
    def read(cls) -> LlsSettings:
        """Return the settings in conf/method/lls.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")


def lls(settings: LlsSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/lls.yaml."""
    chosen = LlsSettings.read() if settings is None else settings
    guards = LinearSettings(chosen.smallest_spread_ratio, chosen.reach_m)
    return OneShotMethod(
        NAME,
        partial(solve_weighted_linear, settings=guards),
        chosen.calibration,
        sigma_m=chosen.sigma_m,
        sigma_per_m=chosen.sigma_per_m,
    )
