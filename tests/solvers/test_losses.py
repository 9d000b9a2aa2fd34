from __future__ import annotations

import pytest
import torch

from fploc.solvers.losses import CauchyLoss, Loss, OneSidedLoss, SoftL1Loss, SquaredLoss

LOSSES = [SquaredLoss(), SoftL1Loss(0.5), CauchyLoss(0.5), OneSidedLoss(4.0, 0.3)]
FAR = 1e6


def residuals() -> torch.Tensor:
    return torch.tensor([-500.0, -3.0, -0.4, -1e-3, 1e-3, 0.4, 3.0, 500.0], dtype=torch.float64)


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_weight_and_curvature_are_those_of_the_value(loss: Loss) -> None:
    scaled = residuals().requires_grad_()
    (slope,) = torch.autograd.grad(loss.value(scaled).sum(), scaled, create_graph=True)
    (curvature,) = torch.autograd.grad(slope.sum(), scaled)
    torch.testing.assert_close(loss.weight(scaled) * scaled, slope)
    torch.testing.assert_close(loss.curvature(scaled), curvature)


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_nothing_costs_nothing_and_stays_finite(loss: Loss) -> None:
    nothing = torch.zeros(1, dtype=torch.float64)
    assert loss.value(nothing) == 0 < loss.weight(nothing)
    assert (loss.value(residuals()) > 0).all() and torch.isfinite(loss.curvature(nothing)).all()


def test_small_residuals_keep_their_digits() -> None:
    tiny = torch.tensor([-1e-9, 1e-9], dtype=torch.float64)
    for loss in LOSSES[:3]:
        torch.testing.assert_close(loss.value(tiny), tiny.square() / 2, rtol=1e-6, atol=0)


def test_far_residuals_cost_what_the_names_promise() -> None:
    far = torch.tensor([FAR], dtype=torch.float64)
    torch.testing.assert_close(SoftL1Loss(0.5).value(far), 0.5 * far, rtol=1e-5, atol=0)
    assert float(CauchyLoss(0.5).value(10 * far) - CauchyLoss(0.5).value(far)) < 0.6


def test_only_ranges_that_are_too_short_cost_four_times() -> None:
    loss = OneSidedLoss(short_weight=4.0, long_scale=0.3)
    one = torch.ones(1, dtype=torch.float64)
    torch.testing.assert_close(loss.value(one), 4 * SquaredLoss().value(one))
    torch.testing.assert_close(loss.value(-one), SoftL1Loss(0.3).value(one))
