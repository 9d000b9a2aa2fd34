from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from fploc.intervals import Intervals
from fploc.methods.nls import nls
from fploc.methods.nls_onesided import nls_onesided
from fploc.methods.nls_robust import RobustSettings, nls_robust, read_settings
from fploc.methods.nls_weighted import nls_weighted
from fploc.methods.one_shot import OneShotMethod
from fploc.solvers.losses import CauchyLoss, Loss, OneSidedLoss, SoftL1Loss, SquaredLoss
from rooms import room

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (8.0, 18.0)]
SITE = room(CORNERS)
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


def alike(loss: Loss) -> OneShotMethod:
    """Return least squares with a loss, whatever else has been tuned."""
    return nls_robust(RobustSettings(loss, sigma_m=1.0, sigma_per_m=0.0, advantage=0.25, calibration="none"))


LOSSES = [SoftL1Loss(0.5), CauchyLoss(0.5), OneSidedLoss(short_weight=4.0, long_scale=0.3)]


@pytest.mark.parametrize("loss", LOSSES)
def test_a_range_through_walls_pulls_less_than_its_square(loss: Loss) -> None:
    intervals = with_one_range_longer(6.0)
    assert (errors(alike(loss), intervals) < 0.5 * errors(alike(SquaredLoss()), intervals)).all()


@pytest.mark.parametrize("loss", LOSSES)
def test_an_outlier_of_500_m_pulls_by_less_than_a_metre(loss: Loss) -> None:
    assert (errors(alike(loss), with_one_range_longer(500.0)) < 1.0).all()


def test_ranges_that_grow_vaguer_with_their_length_weigh_less_when_long() -> None:
    far = with_one_range_longer(3.0)
    even = RobustSettings(SquaredLoss(), sigma_m=1.0, sigma_per_m=0.0, advantage=0.25, calibration="none")
    growing = nls_robust(replace(even, sigma_per_m=0.5))
    assert errors(growing, far).sum() < errors(nls_robust(even), far).sum()


@pytest.mark.parametrize("make", [nls, nls_weighted, nls_robust, nls_onesided])
def test_their_files_hold_a_loss_of_their_own(make: Callable[[], OneShotMethod]) -> None:
    losses = {
        "nls": SquaredLoss,
        "nls-weighted": SquaredLoss,
        "nls-robust": SoftL1Loss,
        "nls-onesided": OneSidedLoss,
    }
    assert isinstance(read_settings(make().name).loss, losses[make().name])
