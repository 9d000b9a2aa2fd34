from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from fploc.intervals import Estimate, NoFix
from fploc.solvers.losses import SquaredLoss
from fploc.solvers.nonlinear import NonlinearSettings, solve_near, solve_nonlinear
from fploc.solvers.planar import spread_ratios

SQUARE = torch.tensor([[0.0, 0.0], [20.0, 0.0], [20.0, 15.0], [0.0, 15.0], [9.0, 7.0]], dtype=torch.float64)
coordinate = st.floats(-30.0, 30.0, allow_nan=False)
point = st.tuples(coordinate, coordinate)


def true_ranges(points: torch.Tensor, access_points: torch.Tensor = SQUARE) -> torch.Tensor:
    return torch.cdist(points, access_points)


def solve(
    ranges: torch.Tensor, heard: torch.Tensor | None = None, access_points: torch.Tensor = SQUARE
) -> Estimate:
    everything = torch.ones_like(ranges, dtype=torch.bool)
    return solve_nonlinear(
        ranges, access_points, torch.ones_like(ranges), everything if heard is None else heard
    )


@settings(deadline=None, max_examples=150)
@given(access_points=st.lists(point, min_size=3, max_size=8), position=point)
def test_noise_free_ranges_give_back_the_position(
    access_points: list[tuple[float, float]], position: tuple[float, float]
) -> None:
    stations = torch.tensor(access_points, dtype=torch.float64)
    truth = torch.tensor([position], dtype=torch.float64)
    heard = torch.ones(1, len(stations), dtype=torch.bool)
    assume(spread_ratios(stations, heard).item() > 0.1)
    assume(torch.cdist(truth, stations).min() > 0.1)
    found = solve(true_ranges(truth, stations), access_points=stations)
    assert found.fixed.all()
    assert torch.dist(found.positions, truth) < 1e-6


def test_it_reaches_the_least_cost_that_many_starts_find() -> None:
    generator = torch.Generator().manual_seed(3)
    truth = torch.rand(12, 2, generator=generator, dtype=torch.float64) * 20
    noise = torch.randn(12, len(SQUARE), generator=generator, dtype=torch.float64).abs() * 3
    ranges = true_ranges(truth) + noise
    everywhere = torch.ones_like(ranges, dtype=torch.bool)
    found = solve_nonlinear(
        ranges, SQUARE, torch.ones_like(ranges), everywhere, settings=NonlinearSettings(advantage=1.0)
    )
    grid = [(x, y) for x in (-5.0, 5.0, 15.0, 25.0) for y in (-5.0, 5.0, 10.0, 20.0)]
    for row in range(len(truth)):
        measured = ranges[row].numpy()

        def residuals(p: np.ndarray, measured: np.ndarray = measured) -> np.ndarray:
            return np.linalg.norm(p - SQUARE.numpy(), axis=1) - measured

        least = min(least_squares(residuals, start, xtol=1e-12, ftol=1e-12).cost for start in grid)
        cost = (residuals(found.positions[row].numpy()) ** 2).sum() / 2
        assert cost <= least + 1e-6


def test_the_order_of_access_points_changes_nothing() -> None:
    truth = torch.tensor([[3.0, 4.0], [17.0, 11.0]], dtype=torch.float64)
    ranges = true_ranges(truth) + torch.tensor([0.3, -0.4, 1.1, 0.0, 0.7], dtype=torch.float64)
    order = torch.tensor([3, 1, 4, 0, 2])
    one, other = solve(ranges), solve(ranges[:, order], access_points=SQUARE[order])
    torch.testing.assert_close(one.positions, other.positions, atol=1e-6, rtol=0)
    torch.testing.assert_close(one.covariances, other.covariances, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("count", "reason"),
    [(0, NoFix.NO_READING), (1, NoFix.TOO_FEW_RANGES), (2, NoFix.TOO_FEW_RANGES), (3, NoFix.FIXED)],
)
def test_it_needs_three_ranges(count: int, reason: NoFix) -> None:
    heard = (torch.arange(len(SQUARE)) < count)[None]
    found = solve(true_ranges(torch.tensor([[3.0, 4.0]], dtype=torch.float64)), heard)
    assert found.reasons.tolist() == [reason]
    assert torch.isfinite(found.positions).all().item() is (reason == NoFix.FIXED)


@pytest.mark.parametrize(
    "places",
    [[[0.0, 0.0], [10.0, 5.0], [20.0, 10.0]], [[0.0, 0.0], [10.0, 5.0], [10.0, 5.0]], [[4.0, 4.0]] * 3],
    ids=["on a line", "one twice", "all at one place"],
)
def test_a_mirror_image_is_no_fix(places: list[list[float]]) -> None:
    access_points = torch.tensor(places, dtype=torch.float64)
    ranges = true_ranges(torch.tensor([[3.0, 9.0]], dtype=torch.float64), access_points)
    found = solve(ranges, access_points=access_points)
    assert found.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY]
    assert found.positions.isnan().all()


def test_an_access_point_listed_twice_counts_twice() -> None:
    access_points = torch.cat([SQUARE, SQUARE[:1]])
    truth = torch.tensor([[3.0, 4.0]], dtype=torch.float64)
    found = solve(true_ranges(truth, access_points), access_points=access_points)
    torch.testing.assert_close(found.positions, truth, atol=1e-6, rtol=0)


def test_a_range_of_500_m_leaves_a_finite_fix_with_a_wide_covariance() -> None:
    truth = torch.tensor([[3.0, 4.0]], dtype=torch.float64)
    ranges = true_ranges(truth)
    honest = solve(ranges).covariances
    ranges[0, 2] = 500.0
    found = solve(ranges)
    assert found.fixed.all() and torch.isfinite(found.positions).all()
    assert torch.linalg.eigvalsh(found.covariances).max() > 100 * torch.linalg.eigvalsh(honest).max()


def test_a_device_at_an_access_point_is_found() -> None:
    truth = SQUARE[4:]
    found = solve(true_ranges(truth))
    assert found.fixed.all()
    torch.testing.assert_close(found.positions, truth, atol=1e-4, rtol=0)


def test_ranges_that_were_not_heard_do_not_matter() -> None:
    truth = torch.tensor([[3.0, 4.0]], dtype=torch.float64)
    heard = torch.tensor([[True, True, False, True, True]])
    ranges = true_ranges(truth)
    ranges[0, 2] = torch.nan
    torch.testing.assert_close(solve(ranges, heard).positions, truth, atol=1e-6, rtol=0)


def test_a_weighted_range_pulls_as_its_sigma_says() -> None:
    truth = torch.tensor([[3.0, 4.0]], dtype=torch.float64)
    ranges = true_ranges(truth)
    ranges[0, 2] += 5.0
    heard = torch.ones_like(ranges, dtype=torch.bool)
    sigmas = torch.ones_like(ranges)
    sigmas[0, 2] = 1000.0
    found = solve_nonlinear(ranges, SQUARE, sigmas, heard)
    assert torch.dist(found.positions, truth) < 1e-3 < torch.dist(solve(ranges).positions, truth)


def test_covariance_is_that_of_many_noisy_solutions() -> None:
    generator = torch.Generator().manual_seed(1)
    truth = torch.tensor([[12.0, 5.0]], dtype=torch.float64).expand(4000, 2)
    sigma = 0.2
    ranges = true_ranges(truth)
    ranges = ranges + sigma * torch.randn(ranges.shape, generator=generator, dtype=torch.float64)
    heard = torch.ones_like(ranges, dtype=torch.bool)
    found = solve_nonlinear(ranges, SQUARE, torch.full_like(ranges, sigma), heard)
    scatter = torch.cov(found.positions.T)
    one = solve_nonlinear(true_ranges(truth[:1]), SQUARE, torch.full((1, 5), sigma).double(), heard[:1])
    torch.testing.assert_close(one.covariances[0], scatter, rtol=0.1, atol=2e-4)


def test_a_further_start_can_only_lower_the_cost() -> None:
    ranges = true_ranges(torch.tensor([[3.0, 4.0]], dtype=torch.float64)) + 2.0
    heard = torch.ones_like(ranges, dtype=torch.bool)
    previous = torch.tensor([[[3.2, 4.1]]], dtype=torch.float64)
    with_it = solve_nonlinear(ranges, SQUARE, torch.ones_like(ranges), heard, starts=previous)
    torch.testing.assert_close(with_it.positions, solve(ranges).positions, atol=1e-6, rtol=0)


def test_squared_loss_has_the_weight_of_its_slope() -> None:
    scaled = torch.linspace(-3, 3, 7, dtype=torch.float64, requires_grad=True)
    slope = torch.autograd.grad(SquaredLoss().value(scaled).sum(), scaled)[0]
    torch.testing.assert_close(SquaredLoss().weight(scaled) * scaled, slope)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_residuals_beyond_the_sigmas_widen_the_covariance(count: int) -> None:
    heard = (torch.arange(len(SQUARE)) < count)[None]
    ranges = true_ranges(torch.tensor([[3.0, 4.0]], dtype=torch.float64))
    ranges = ranges + torch.tensor([1.3, -0.9, 0.8, -1.1, 0.7], dtype=torch.float64)
    sigmas = torch.tensor([[0.1, 0.2, 0.15, 0.1, 0.3]], dtype=torch.float64)
    found = solve_nonlinear(ranges, SQUARE, sigmas, heard)
    away = found.positions - SQUARE[:count]
    distances = away.norm(dim=-1)
    rows = away / distances[:, None] / sigmas[0, :count, None]
    residuals = (distances - ranges[0, :count]) / sigmas[0, :count]
    scale = residuals.square().sum() / max(count - 2, 1)
    assert scale > 1.0
    torch.testing.assert_close(
        found.covariances[0], scale * torch.linalg.inv(rows.T @ rows), rtol=1e-6, atol=0
    )


def test_near_a_start_the_minimum_on_its_side_is_found() -> None:
    # Access points on a line: a place and its mirror image fit alike.
    line = torch.tensor([[0.0, 0.0], [10.0, 0.0], [5.0, 0.0]], dtype=torch.float64)
    sides = torch.tensor([[4.0, 3.0], [4.0, -3.0]], dtype=torch.float64)
    ranges = true_ranges(sides, line)
    heard, sigmas = torch.ones_like(ranges, dtype=torch.bool), torch.ones_like(ranges)
    unguarded = NonlinearSettings(smallest_spread_ratio=0.0)
    for order in ([0, 1], [1, 0]):
        starts = sides[order] + 0.7
        found = solve_near(ranges, line, sigmas, heard, starts=starts, settings=unguarded)
        torch.testing.assert_close(found.positions, sides[order], atol=1e-6, rtol=0)
    guarded = solve_near(ranges, line, sigmas, heard, starts=sides)
    assert guarded.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY] * 2
    ranges[:, 2] = torch.nan
    fewer = heard & torch.tensor([True, True, False])
    assert (
        solve_near(ranges, line, sigmas, fewer, starts=sides).reasons.tolist() == [NoFix.TOO_FEW_RANGES] * 2
    )
