from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from fploc.intervals import Intervals
from fploc.methods.nls import nls
from fploc.methods.nls_onesided import nls_onesided
from fploc.methods.nls_robust import NAME, nls_robust, read_settings
from fploc.methods.one_shot import OneShotMethod
from fploc.sites.site import AccessPoint, Site
from fploc.solvers.losses import CauchyLoss

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (8.0, 18.0)]
SITE = Site(
    name="box",
    place="box",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 2.0)
        for index, (x, y) in enumerate(CORNERS)
    ),
    device_height_m=1.0,
)
TRUTH = torch.tensor([[6.0, 5.0], [15.0, 9.0], [2.0, 12.0]], dtype=torch.float64)


def with_one_range_longer(by_m: float) -> Intervals:
    ranges = torch.cdist(TRUTH, torch.tensor(CORNERS, dtype=torch.float64))
    ranges[:, 1] += by_m
    return Intervals(
        t_s=torch.zeros(len(TRUTH)),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=torch.full_like(ranges, -60.0),
        heard=torch.ones_like(ranges, dtype=torch.bool),
        present=torch.ones(len(TRUTH), dtype=torch.bool),
    )


def errors(method: OneShotMethod, intervals: Intervals) -> torch.Tensor:
    _, found = method.step(method.init(SITE, len(TRUTH)), intervals)
    assert found.fixed.all()
    return (found.positions - TRUTH).norm(dim=-1)


def cauchy() -> OneShotMethod:
    return nls_robust(replace(read_settings(NAME), loss=CauchyLoss(0.5)))


@pytest.mark.parametrize("made", [nls_robust, cauchy, nls_onesided])
def test_a_range_through_walls_pulls_less_than_its_square(made: type[OneShotMethod]) -> None:
    intervals = with_one_range_longer(6.0)
    assert (errors(made(), intervals) < 0.5 * errors(nls(), intervals)).all()


@pytest.mark.parametrize("made", [nls_robust, cauchy, nls_onesided])
def test_an_outlier_of_500_m_pulls_by_less_than_a_metre(made: type[OneShotMethod]) -> None:
    assert (errors(made(), with_one_range_longer(500.0)) < 1.0).all()
