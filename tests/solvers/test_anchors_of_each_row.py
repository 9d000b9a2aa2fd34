"""Every solver takes one site's access points or each interval's own: another device may be one of them."""

from __future__ import annotations

import pytest
import torch

from fploc.methods.one_shot import RangeSolver
from fploc.solvers.linear import solve_linear
from fploc.solvers.nonlinear import solve_nonlinear
from fploc.solvers.trilateration import solve_trilateration

SOLVERS = pytest.mark.parametrize("solve", [solve_linear, solve_nonlinear, solve_trilateration])
RANDOM = torch.Generator().manual_seed(0)
ANCHORS = 30 * torch.rand(20, 5, 2, generator=RANDOM, dtype=torch.float64)
TRUTH = 30 * torch.rand(20, 2, generator=RANDOM, dtype=torch.float64)
RANGES = (TRUTH[:, None] - ANCHORS).norm(dim=-1)
NOISY = (RANGES + 0.5 * torch.randn(20, 5, generator=RANDOM, dtype=torch.float64)).clamp(min=0.1)
HEARD = torch.rand(20, 5, generator=RANDOM) < 0.8


@SOLVERS
def test_noise_free_ranges_to_anchors_of_each_row_give_back_the_positions(solve: RangeSolver) -> None:
    found = solve(RANGES, ANCHORS, torch.ones_like(RANGES), torch.ones_like(HEARD))
    assert found.fixed.all()
    torch.testing.assert_close(found.positions, TRUTH, rtol=0.0, atol=1e-6)


@SOLVERS
def test_it_is_the_same_as_each_row_alone(solve: RangeSolver) -> None:
    together = solve(NOISY, ANCHORS, torch.ones_like(NOISY), HEARD)
    for row in range(len(NOISY)):
        at = slice(row, row + 1)
        alone = solve(NOISY[at], ANCHORS[row], torch.ones_like(NOISY[at]), HEARD[at])
        torch.testing.assert_close(together.positions[at], alone.positions, equal_nan=True)
        torch.testing.assert_close(together.covariances[at], alone.covariances, equal_nan=True)
        assert together.reasons[row] == alone.reasons[0]


@SOLVERS
def test_one_layout_repeated_is_that_layout(solve: RangeSolver) -> None:
    sigmas = torch.ones_like(NOISY)
    one = solve(NOISY, ANCHORS[0], sigmas, HEARD)
    repeated = solve(NOISY, ANCHORS[0].expand(20, 5, 2), sigmas, HEARD)
    torch.testing.assert_close(one.positions, repeated.positions, equal_nan=True)
    assert torch.equal(one.reasons, repeated.reasons)
