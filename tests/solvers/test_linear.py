from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fploc.intervals import Estimate, NoFix
from fploc.solvers.linear import LinearSettings, nearest_access_points, solve_linear, solve_weighted_linear
from fploc.solvers.planar import spread_ratios

SQUARE = torch.tensor([[0.0, 0.0], [20.0, 0.0], [20.0, 15.0], [0.0, 15.0], [9.0, 7.0]], dtype=torch.float64)
TRUTH = torch.tensor([[3.0, 4.0], [17.0, 11.0]], dtype=torch.float64)
coordinate = st.floats(-30.0, 30.0, allow_nan=False)
point = st.tuples(coordinate, coordinate)


def solve(
    ranges: torch.Tensor, heard: torch.Tensor | None = None, access_points: torch.Tensor = SQUARE
) -> Estimate:
    present = torch.ones_like(ranges, dtype=torch.bool) if heard is None else heard
    reference = nearest_access_points(ranges, present)
    return solve_linear(ranges, access_points, torch.ones_like(ranges), present, reference=reference)


@settings(deadline=None, max_examples=150)
@given(access_points=st.lists(point, min_size=3, max_size=8), position=point)
def test_noise_free_ranges_give_back_the_position(
    access_points: list[tuple[float, float]], position: tuple[float, float]
) -> None:
    stations = torch.tensor(access_points, dtype=torch.float64)
    truth = torch.tensor([position], dtype=torch.float64)
    assume(spread_ratios(stations, torch.ones(1, len(stations), dtype=torch.bool)).item() > 0.05)
    found = solve(torch.cdist(truth, stations), access_points=stations)
    assert found.fixed.all()
    assert torch.dist(found.positions, truth) < 1e-6


def test_any_reference_gives_the_same_without_noise() -> None:
    ranges = torch.cdist(TRUTH, SQUARE)
    heard = torch.ones_like(ranges, dtype=torch.bool)
    for index in range(len(SQUARE)):
        found = solve_linear(
            ranges, SQUARE, torch.ones_like(ranges), heard, reference=torch.full((2,), index)
        )
        torch.testing.assert_close(found.positions, TRUTH)


def test_the_order_of_access_points_changes_nothing() -> None:
    ranges = torch.cdist(TRUTH, SQUARE) + torch.tensor([0.3, -0.4, 1.1, 0.0, 0.7]).double()
    order = torch.tensor([3, 1, 4, 0, 2])
    one, other = solve(ranges), solve(ranges[:, order], access_points=SQUARE[order])
    torch.testing.assert_close(one.positions, other.positions)
    torch.testing.assert_close(one.covariances, other.covariances)


@pytest.mark.parametrize(
    ("count", "reason"),
    [(0, NoFix.NO_READING), (1, NoFix.TOO_FEW_RANGES), (2, NoFix.TOO_FEW_RANGES), (3, NoFix.FIXED)],
)
def test_it_needs_three_ranges(count: int, reason: NoFix) -> None:
    heard = (torch.arange(len(SQUARE)) < count).expand(2, -1)
    found = solve(torch.cdist(TRUTH, SQUARE), heard)
    assert found.reasons.tolist() == [reason, reason]
    assert torch.isfinite(found.positions).all().item() is (reason == NoFix.FIXED)


def test_access_points_on_a_line_give_no_fix() -> None:
    line = torch.tensor([[0.0, 0.0], [10.0, 5.0], [20.0, 10.0], [10.0, 5.0]], dtype=torch.float64)
    found = solve(torch.cdist(TRUTH, line), access_points=line)
    assert found.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY] * 2
    assert found.positions.isnan().all()


def test_a_range_outlier_is_refused_where_it_throws_the_position_out_of_reach() -> None:
    ranges = torch.cdist(TRUTH, SQUARE)
    ranges[0, 2] = 500.0
    found = solve(ranges)
    assert found.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY, NoFix.FIXED]
    heard = torch.ones_like(ranges, dtype=torch.bool)
    unguarded = solve_linear(
        ranges,
        SQUARE,
        torch.ones_like(ranges),
        heard,
        reference=nearest_access_points(ranges, heard),
        settings=LinearSettings(reach_m=1e9),
    )
    assert unguarded.positions[0].norm() > 500.0


def test_ranges_that_were_not_heard_do_not_matter() -> None:
    ranges = torch.cdist(TRUTH, SQUARE)
    ranges[:, 2] = torch.nan
    heard = torch.tensor([True, True, False, True, True]).expand(2, -1)
    torch.testing.assert_close(solve(ranges, heard).positions, TRUTH)


def test_covariance_is_that_of_many_noisy_solutions() -> None:
    generator = torch.Generator().manual_seed(1)
    clean = torch.cdist(TRUTH[:1], SQUARE).expand(20000, -1)
    sigma = 0.05
    noisy = clean + sigma * torch.randn(clean.shape, generator=generator, dtype=torch.float64)
    heard = torch.ones_like(noisy, dtype=torch.bool)
    found = solve_linear(
        noisy, SQUARE, torch.full_like(noisy, sigma), heard, reference=torch.zeros(20000, dtype=torch.int64)
    )
    torch.testing.assert_close(torch.cov(found.positions.T), found.covariances.mean(0), rtol=0.05, atol=1e-4)


def test_ranges_of_zero_leave_a_covariance_that_can_be_inverted() -> None:
    ranges = torch.zeros(1, len(SQUARE), dtype=torch.float64)
    heard = torch.ones_like(ranges, dtype=torch.bool)
    found = solve_linear(
        ranges, SQUARE, torch.ones_like(ranges), heard, settings=LinearSettings(reach_m=100.0)
    )
    assert found.fixed.all()
    assert (torch.linalg.eigvalsh(found.covariances) > 1e-6).all()


def covariance_of_rows(ranges: torch.Tensor, sigmas: torch.Tensor, reference: int) -> torch.Tensor:
    """Return C of one interval's rows, as the docstring of ``solve_weighted_linear`` writes it."""
    squares = 4 * ranges**2 * sigmas**2 + 2 * sigmas**4
    others = [index for index in range(len(ranges)) if index != reference]
    return squares[reference] + torch.diag(squares[others])


UNEQUAL = torch.tensor([0.2, 1.5, 0.7, 3.0, 0.4], dtype=torch.float64)
NOISE = torch.tensor([0.3, -0.4, 1.1, 0.2, -0.7], dtype=torch.float64)


@pytest.mark.parametrize("row", [0, 1])
def test_the_weighted_solution_is_generalized_least_squares(row: int) -> None:
    ranges = torch.cdist(TRUTH, SQUARE) + NOISE
    sigmas = torch.stack([UNEQUAL, UNEQUAL.flip(0)])
    heard = torch.ones_like(ranges, dtype=torch.bool)
    found = solve_weighted_linear(ranges, SQUARE, sigmas, heard)

    reference = int(ranges[row].argmin())
    others = [index for index in range(len(SQUARE)) if index != reference]
    matrix = 2 * (SQUARE[others] - SQUARE[reference])
    squares = SQUARE.square().sum(-1) - ranges[row].square()
    right = squares[others] - squares[reference]
    inverse = torch.linalg.inv(covariance_of_rows(ranges[row], sigmas[row], reference))
    covariance = torch.linalg.inv(matrix.T @ inverse @ matrix)
    torch.testing.assert_close(found.covariances[row], covariance)
    torch.testing.assert_close(found.positions[row], covariance @ matrix.T @ inverse @ right)


def test_the_covariance_carries_unequal_variances_through_the_solution() -> None:
    ranges = torch.cdist(TRUTH[:1], SQUARE)
    heard = torch.ones_like(ranges, dtype=torch.bool)
    found = solve_linear(ranges, SQUARE, UNEQUAL[None], heard, reference=torch.tensor([2]))
    matrix = 2 * (SQUARE[[0, 1, 3, 4]] - SQUARE[2])
    gain = torch.linalg.pinv(matrix)
    expected = gain @ covariance_of_rows(ranges[0], UNEQUAL, 2) @ gain.T
    torch.testing.assert_close(found.covariances[0], expected)


def test_without_a_reference_the_nearest_is_taken() -> None:
    ranges = torch.cdist(TRUTH, SQUARE) + NOISE
    heard = torch.ones_like(ranges, dtype=torch.bool)
    one = solve_linear(ranges, SQUARE, torch.ones_like(ranges), heard)
    other = solve(ranges)
    torch.testing.assert_close(one.positions, other.positions)


def test_unheard_ranges_weigh_nothing() -> None:
    ranges = torch.cdist(TRUTH, SQUARE) + NOISE
    heard = torch.tensor([True, False, True, True, True]).expand(2, -1)
    kept = [0, 2, 3, 4]
    sigmas = UNEQUAL.expand(2, -1)
    one = solve_weighted_linear(ranges, SQUARE, sigmas, heard)
    other = solve_weighted_linear(ranges[:, kept], SQUARE[kept], sigmas[:, kept], heard[:, kept])
    torch.testing.assert_close(one.positions, other.positions)
    torch.testing.assert_close(one.covariances, other.covariances)


@pytest.mark.parametrize("solver", [solve_linear, solve_weighted_linear])
def test_the_guards_are_where_the_settings_put_them(solver: Callable[..., Estimate]) -> None:
    ranges = torch.cdist(TRUTH[:1], SQUARE) + 2 * NOISE
    heard = torch.ones_like(ranges, dtype=torch.bool)
    free = LinearSettings(smallest_spread_ratio=0.0, reach_m=1e9)
    nearest = int(ranges.argmin())
    solved = solver(ranges, SQUARE, torch.ones_like(ranges), heard, settings=free).positions[0]
    excess = float(torch.dist(solved, SQUARE[nearest]) - ranges[0, nearest])
    ratio = spread_ratios(SQUARE, heard).item()
    for reach_m, smallest, reason in (
        (excess + 1e-6, 0.0, NoFix.FIXED),
        (excess - 1e-6, 0.0, NoFix.DEGENERATE_GEOMETRY),
        (1e9, ratio, NoFix.FIXED),
        (1e9, ratio + 1e-6, NoFix.DEGENERATE_GEOMETRY),
    ):
        guards = LinearSettings(smallest_spread_ratio=smallest, reach_m=reach_m)
        found = solver(ranges, SQUARE, torch.ones_like(ranges), heard, settings=guards)
        assert found.reasons.tolist() == [reason]
