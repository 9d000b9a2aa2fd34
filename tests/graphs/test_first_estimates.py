from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fploc.graphs.first_estimates import MARGIN_M, first_estimates
from fploc.intervals import Intervals


def intervals(ranges: Tensor, heard: Tensor) -> Intervals:
    return Intervals(
        t_s=torch.zeros(len(ranges), dtype=torch.float64),
        ranges=ranges * heard,
        stds=torch.zeros_like(ranges),
        rss=torch.zeros_like(ranges),
        heard=heard,
        present=torch.ones(len(ranges), dtype=torch.bool),
    )


SQUARE = torch.tensor([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def test_noise_free_ranges_give_back_the_position() -> None:
    truth = torch.tensor([[2.0, 3.0], [9.0, 1.0], [5.0, 5.0], [-3.0, 12.0]])
    ranges = (truth[:, None] - SQUARE).norm(dim=-1)
    found = first_estimates(intervals(ranges, torch.ones(4, 4, dtype=torch.bool)), SQUARE)
    assert found.dtype == SQUARE.dtype
    torch.testing.assert_close(found, truth, rtol=0.0, atol=1e-4)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 7))
def test_estimates_are_finite_and_inside_the_widened_box(seed: int, number: int) -> None:
    random = torch.Generator().manual_seed(seed)
    access_points = 40 * torch.rand(number, 2, generator=random) - 20
    ranges = 60 * torch.rand(16, number, generator=random)
    heard = torch.rand(16, number, generator=random) < 0.7
    found = first_estimates(intervals(ranges, heard), access_points)
    assert found.shape == (16, 2) and torch.isfinite(found).all()
    slack = MARGIN_M + 1e-4
    assert (found >= access_points.amin(0) - slack).all() and (found <= access_points.amax(0) + slack).all()


def test_a_solution_far_out_is_brought_to_the_box() -> None:
    """Ranges of a place 30 m to the east of the square, which trilateration finds."""
    truth = torch.tensor([[40.0, 5.0]])
    ranges = (truth[:, None] - SQUARE).norm(dim=-1)
    found = first_estimates(intervals(ranges, torch.ones(1, 4, dtype=torch.bool)), SQUARE)
    torch.testing.assert_close(found, torch.tensor([[15.0, 5.0]]), rtol=0.0, atol=1e-3)


def test_without_a_fix_it_is_the_centre_weighted_by_nearness() -> None:
    ranges = torch.tensor([[2.0, 6.0, 0.0, 0.0], [0.2, 4.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0], [0.0] * 4])
    heard = torch.tensor(
        [[True, True, False, False], [True, True, False, False], [True] + [False] * 3, [False] * 4]
    )
    found = first_estimates(intervals(ranges, heard), SQUARE)
    # Weights 1/2 and 1/6; a range below 1 m counts as 1 m: weights 1 and 1/4; nothing heard: the middle.
    expected = torch.tensor([[2.5, 0.0], [2.0, 0.0], [0.0, 0.0], [5.0, 5.0]])
    torch.testing.assert_close(found, expected)


def test_access_points_on_one_line_fall_back_to_the_centre() -> None:
    line = torch.tensor([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]])
    found = first_estimates(intervals(torch.full((1, 3), 4.0), torch.ones(1, 3, dtype=torch.bool)), line)
    torch.testing.assert_close(found, torch.tensor([[5.0, 0.0]]))
