from __future__ import annotations

from itertools import combinations

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fploc.intervals import Estimate, NoFix
from fploc.solvers.linear import solve_linear
from fploc.solvers.trilateration import TrilaterationSettings, solve_trilateration

SQUARE = torch.tensor([[0.0, 0.0], [20.0, 0.0], [20.0, 15.0], [0.0, 15.0], [9.0, 7.0]], dtype=torch.float64)
TRUTH = torch.tensor([[3.0, 4.0], [17.0, 11.0]], dtype=torch.float64)
coordinate = st.floats(-30.0, 30.0, allow_nan=False)


def solve(
    ranges: torch.Tensor, heard: torch.Tensor | None = None, access_points: torch.Tensor = SQUARE
) -> Estimate:
    present = torch.ones_like(ranges, dtype=torch.bool) if heard is None else heard
    return solve_trilateration(ranges, access_points, torch.ones_like(ranges), present)


@settings(deadline=None, max_examples=150)
@given(st.tuples(coordinate, coordinate))
def test_noise_free_ranges_give_back_the_position(position: tuple[float, float]) -> None:
    truth = torch.tensor([position], dtype=torch.float64)
    found = solve(torch.cdist(truth, SQUARE))
    assume(found.fixed.all())
    assert torch.dist(found.positions, truth) < 1e-6


def test_only_the_three_nearest_count() -> None:
    ranges = torch.cdist(TRUTH, SQUARE)
    farther = ranges.argsort(-1)[:, 3:]
    spoilt = ranges.scatter_add(1, farther, torch.full((2, 2), 7.0).double())
    torch.testing.assert_close(solve(spoilt).positions, TRUTH)


def test_the_next_access_point_is_swapped_in_where_three_are_near_singular() -> None:
    line_first = torch.tensor([[0.0, 0.0], [2.0, 0.01], [4.0, 0.0], [3.0, 9.0]], dtype=torch.float64)
    truth = torch.tensor([[1.0, -1.0]], dtype=torch.float64)
    ranges = torch.cdist(truth, line_first)
    ranges[0, 2] += 3.0
    torch.testing.assert_close(solve(ranges, access_points=line_first).positions, truth)


def test_an_access_point_listed_twice_is_swapped_out() -> None:
    access_points = torch.cat([SQUARE[:1], SQUARE])
    found = solve(torch.cdist(TRUTH, access_points), access_points=access_points)
    torch.testing.assert_close(found.positions, TRUTH)


def test_the_order_of_access_points_changes_nothing() -> None:
    ranges = torch.cdist(TRUTH, SQUARE) + torch.tensor([0.3, -0.4, 1.1, 0.0, 0.7]).double()
    order = torch.tensor([3, 1, 4, 0, 2])
    torch.testing.assert_close(
        solve(ranges).positions, solve(ranges[:, order], access_points=SQUARE[order]).positions
    )


@pytest.mark.parametrize(
    ("count", "reason"),
    [(0, NoFix.NO_READING), (1, NoFix.TOO_FEW_RANGES), (2, NoFix.TOO_FEW_RANGES), (3, NoFix.FIXED)],
)
def test_it_needs_three_ranges(count: int, reason: NoFix) -> None:
    heard = (torch.arange(len(SQUARE)) < count).expand(2, -1)
    found = solve(torch.cdist(TRUTH, SQUARE), heard)
    assert found.reasons.tolist() == [reason, reason]
    assert torch.isfinite(found.positions).all().item() is (reason == NoFix.FIXED)


def test_a_site_with_three_access_points_gives_fixes() -> None:
    found = solve(torch.cdist(TRUTH, SQUARE[:3]), access_points=SQUARE[:3])
    torch.testing.assert_close(found.positions, TRUTH)


@pytest.mark.parametrize("count", [1, 2])
def test_a_site_with_few_access_points_gives_no_fix(count: int) -> None:
    found = solve(torch.cdist(TRUTH, SQUARE[:count]), access_points=SQUARE[:count])
    assert found.reasons.tolist() == [NoFix.TOO_FEW_RANGES] * 2
    assert found.positions.shape == (2, 2) and found.covariances.shape == (2, 2, 2)


def test_access_points_on_a_line_give_no_fix() -> None:
    line = torch.tensor([[0.0, 0.0], [10.0, 5.0], [20.0, 10.0]], dtype=torch.float64)
    found = solve(torch.cdist(TRUTH, line), access_points=line)
    assert found.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY] * 2


def test_a_range_of_500_m_among_the_three_gives_no_fix() -> None:
    heard = torch.tensor([True, True, True, False, False]).expand(2, -1)
    ranges = torch.cdist(TRUTH, SQUARE)
    ranges[0, 2] = 500.0
    assert solve(ranges, heard).reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY, NoFix.FIXED]


def first_wide_three(order: list[int], access_points: torch.Tensor, smallest_sine: float) -> list[int] | None:
    """Return the nearest access point and the first pair whose directions from it are wide enough apart."""
    pairs = sorted(combinations(range(1, len(order)), 2), key=lambda pair: (pair[1], pair[0]))
    for pair in pairs:
        three = [order[0], *(order[rank] for rank in pair)]
        one, two = (access_points[index] - access_points[three[0]] for index in three[1:])
        sine = torch.linalg.det(torch.stack([one, two])).abs() / (one.norm() * two.norm())
        if sine > smallest_sine:
            return three
    return None


@pytest.mark.parametrize("smallest_sine", [0.1, 0.5, 0.9, 0.999])
def test_it_solves_for_the_first_three_that_are_wide_enough(smallest_sine: float) -> None:
    generator = torch.Generator().manual_seed(3)
    settings = TrilaterationSettings(smallest_sine=smallest_sine, reach_m=1e9)
    reasons = set()
    for _ in range(40):
        access_points = 30 * torch.rand(5, 2, generator=generator, dtype=torch.float64)
        ranges = 5 + 20 * torch.rand(1, 5, generator=generator, dtype=torch.float64)
        heard = torch.ones(1, 5, dtype=torch.bool)
        found = solve_trilateration(ranges, access_points, torch.ones_like(ranges), heard, settings=settings)
        order = ranges[0].argsort().tolist()
        three = first_wide_three(order, access_points, smallest_sine)
        reasons.add(int(found.reasons[0]))
        if three is None:
            assert found.reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY]
            continue
        alone = solve_linear(
            ranges[:, three],
            access_points[three],
            torch.ones(1, 3, dtype=torch.float64),
            heard[:, three],
            reference=torch.tensor([0]),
        )
        if alone.fixed.all():
            torch.testing.assert_close(found.positions, alone.positions)
            torch.testing.assert_close(found.covariances, alone.covariances)
    assert NoFix.FIXED in reasons
