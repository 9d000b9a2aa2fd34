"""``trilateration``: the three nearest access points, linear (the paper, commented text; rivals.md)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from fploc.conf import instantiate, read_conf
from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.trilateration import TrilaterationSettings, solve_trilateration

NAME = "trilateration"


@dataclass(frozen=True)
class ThreeNearestSettings:
    """Settings of trilateration: conf/method/trilateration.yaml.

    Args:
        smallest_sine: As in ``TrilaterationSettings``.
        reach_m: As in ``LinearSettings``.
        calibration: That it runs with unless asked.
    """

    smallest_sine: float
    reach_m: float
    calibration: str

    @classmethod
    def read(cls) -> ThreeNearestSettings:
        """Return the settings in conf/method/trilateration.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")


def trilateration(settings: ThreeNearestSettings | None = None) -> OneShotMethod:
    """Return the method; settings of None are those of conf/method/trilateration.yaml."""
    chosen = ThreeNearestSettings.read() if settings is None else settings
    guards = TrilaterationSettings(chosen.smallest_sine, chosen.reach_m)
    return OneShotMethod(NAME, partial(solve_trilateration, settings=guards), chosen.calibration)
