from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fploc.methods.belief_grid import LEAST_WEIGHT, NEGLIGIBLE, kernels, moved, posterior


@given(st.floats(-9.0, 9.0), st.floats(0.3, 4.0))
def test_a_kernel_has_the_mean_and_the_variance_that_are_asked_for(shift: float, variance: float) -> None:
    taps = kernels(torch.tensor([shift], dtype=torch.float64), torch.tensor([variance]), reach=24)[0]
    at = torch.arange(-24, 25, dtype=torch.float64)
    assert (taps >= 0).all()
    assert float(taps.sum()) == pytest.approx(1.0, abs=1e-9)
    assert float(taps @ at) == pytest.approx(shift, abs=1e-6)
    assert float(taps @ (at - shift).square()) == pytest.approx(variance, abs=1e-5)


def test_a_shift_without_blur_lies_between_two_cells() -> None:
    taps = kernels(torch.tensor([1.25], dtype=torch.float64), torch.zeros(1), reach=3)[0]
    expected = torch.tensor([0, 0, 0, 0, 0.75, 0.25, 0], dtype=torch.float64)
    torch.testing.assert_close(taps, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("spread", [0.0, 0.1, 0.4, 1.0, 3.7])
def test_a_blur_adds_its_variance_and_keeps_mass_and_mean(spread: float) -> None:
    beliefs = torch.zeros(2, 1, 41, 51, dtype=torch.float64)
    beliefs[0, 0, 20, 25] = beliefs[1, 0, 18, 27] = 1.0
    variances = torch.tensor([[spread**2], [0.0]], dtype=torch.float64)
    blurred = moved(beliefs, torch.zeros(2, 1, 2, dtype=torch.float64), variances)
    torch.testing.assert_close(blurred[1], beliefs[1], atol=1e-12, rtol=0)
    assert (blurred >= 0).all()
    for axis, centre in ((2, 20), (1, 25)):
        along = blurred[0, 0].sum(axis - 1)
        away = torch.arange(len(along), dtype=torch.float64) - centre
        assert float(along.sum()) == pytest.approx(1.0, abs=2e-4)
        assert float((along * away).sum()) == pytest.approx(0.0, abs=1e-9)
        assert float((along * away.square()).sum()) == pytest.approx(spread**2, rel=1e-2, abs=1e-9)


def test_each_belief_goes_its_own_way() -> None:
    beliefs = torch.zeros(1, 2, 9, 9, dtype=torch.float64)
    beliefs[0, :, 4, 4] = 1.0
    shifts = torch.tensor([[[3.0, 0.0], [-1.0, 2.0]]], dtype=torch.float64)
    there = moved(beliefs, shifts, torch.zeros(1, 2, dtype=torch.float64))
    assert float(there[0, 0, 7, 4]) == pytest.approx(1.0, abs=1e-12)
    assert float(there[0, 1, 3, 6]) == pytest.approx(1.0, abs=1e-12)


def test_a_shift_beyond_the_grid_leaves_nothing_there() -> None:
    beliefs = torch.full((1, 1, 6, 5), 1 / 30, dtype=torch.float64)
    shifts = torch.tensor([[[80.0, 0.0]]], dtype=torch.float64)
    assert float(moved(beliefs, shifts, torch.zeros(1, 1, dtype=torch.float64)).sum()) < 1e-9


def test_a_posterior_is_bayes_rule_over_all_beliefs_of_a_device() -> None:
    before = torch.tensor([[[[0.1, 0.3]], [[0.2, 0.4]]]], dtype=torch.float64)
    after = posterior(before, torch.tensor([[2.0, 4.0]], dtype=torch.float64).log())
    expected = torch.tensor([[[[0.2, 1.2]], [[0.4, 1.6]]]], dtype=torch.float64) / 3.4
    torch.testing.assert_close(after, expected)


def test_negligible_cells_are_dropped_and_something_always_stays() -> None:
    before = torch.tensor([[[[1.0, 0.5 * NEGLIGIBLE, 2 * NEGLIGIBLE]]]])
    kept = posterior(before, torch.zeros(1, 3, dtype=torch.float64))
    assert (kept[0, 0, 0] > 0).tolist() == [True, False, True]
    # All the belief is where the interval says that nobody can be.
    lone = posterior(torch.tensor([[[[1.0, 0.0]]]]), torch.tensor([[-1e4, 0.0]], dtype=torch.float64))
    assert torch.finfo(torch.float32).tiny < LEAST_WEIGHT
    torch.testing.assert_close(lone, torch.tensor([[[[1.0, 0.0]]]]))
