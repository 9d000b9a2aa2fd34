from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fploc.methods.belief_grid import (
    LEAST_WEIGHT,
    NEGLIGIBLE,
    BeliefGrid,
    Window,
    banded,
    kernels,
    moved,
    posterior,
)
from fploc.sites.site import AccessPoint, Site
from rooms import open_plan


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


def test_what_is_negligible_is_so_in_all_beliefs_of_a_device_together() -> None:
    before = torch.tensor([[[[0.9, 0.9 * NEGLIGIBLE]], [[0.1, 0.2 * NEGLIGIBLE]]]])
    kept = posterior(before, torch.zeros(1, 2, dtype=torch.float64))
    torch.testing.assert_close(kept, before / before.sum(), atol=0, rtol=1e-5)


@given(st.integers(1, 9), st.integers(0, 6), st.integers(0, 99))
def test_banded_matrices_convolve(cells: int, reach: int, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    taps, values = torch.rand(2 * reach + 1, generator=generator), torch.rand(cells, generator=generator)
    whole = torch.from_numpy(np.convolve(values.numpy(), taps.numpy()))
    torch.testing.assert_close(banded(taps, cells) @ values, whole[reach : reach + cells])


SITE = Site(
    name="box",
    place="box",
    access_points=(
        AccessPoint("AP0", "00:00:00:00:00:00", 0.0, 0.0, 2.0),
        AccessPoint("AP1", "00:00:00:00:00:01", 8.0, 6.0, 2.0),
    ),
    device_height_m=1.0,
)
GRID = BeliefGrid.over(SITE, cell_m=0.5, margin_m=1.0)


def somewhere(*places: tuple[int, int]) -> torch.Tensor:
    """Return two beliefs of each device, both at its cell, shape (B, 2, X, Y)."""
    beliefs = torch.zeros(len(places), 2, len(GRID.xs_m), len(GRID.ys_m))
    for device, (x, y) in enumerate(places):
        beliefs[device, 0, x, y], beliefs[device, 1, x, y] = 0.75, 0.25
    return beliefs


@given(st.integers(0, 19), st.integers(0, 15), st.integers(0, 20))
def test_a_window_holds_all_beliefs_and_what_they_reach(x: int, y: int, reach: int) -> None:
    beliefs, others = somewhere((x, y), (10, 8)), somewhere((x, y), (12, 8))
    whole = Window.whole(GRID, 2)
    window = whole.around([beliefs, others], reach)
    assert window.shape == (min(20, 3 + 2 * reach), min(16, 1 + 2 * reach))
    for one in (beliefs, others):
        held = window.cut(one, whole)
        torch.testing.assert_close(whole.cut(held, window), one, atol=0, rtol=0)
        # Held on a window, beliefs are in the same place; rows of zeros at its end may reach beyond the grid.
        longer = torch.nn.functional.pad(held, (0, 3, 0, 2))
        held_longer = Window(GRID, window.first_x, window.first_y, (longer.shape[2], longer.shape[3]))
        torch.testing.assert_close(whole.cut(longer, held_longer), one, atol=0, rtol=0)
        again = held_longer.around([longer], reach=0)
        for device in range(2):
            assert again.rows[device][one[device].sum((0, 2))[again.rows[device]] > 0].numel() == 1
    for near in range(-reach, reach + 1):
        if 0 <= x + near < 20:
            assert x + near in window.rows[0]
        if 0 <= y + near < 16:
            assert y + near in window.columns[0]


def test_a_window_knows_the_cells_of_its_grid() -> None:
    grid = replace(GRID, plan_log=torch.arange(len(GRID.cells_m), dtype=torch.float64))
    window = Window.whole(grid, 2).around([somewhere((3, 4), (11, 15))], reach=2)
    for device in range(2):
        cells = torch.cartesian_prod(grid.xs_m[window.rows[device]], grid.ys_m[window.columns[device]])
        torch.testing.assert_close(grid.cells_m[window.cells[device]], cells, atol=0, rtol=0)
        torch.testing.assert_close(window.distances_m[device], grid.distances_m[:, window.cells[device]])
    torch.testing.assert_close(window.plan_log, window.cells.double())


def test_a_plan_says_of_each_cell_which_access_points_it_sees() -> None:
    plan = open_plan(SITE)
    walls = plan.walls.copy()
    walls[:, 58:62] = True
    grid = GRID.on(replace(plan, walls=walls), SITE, blocked=0.1)
    # The wall runs from x = 3.8 to 4.2 m between both access points.
    left, right = grid.cells_m[:, 0] < 3.8, grid.cells_m[:, 0] > 4.2
    assert (grid.walled[:, left] == torch.tensor([[0], [1]])).all()
    assert (grid.walled[:, right] == torch.tensor([[1], [0]])).all()
    assert not GRID.walled.any()
    window = Window.whole(grid, 2).around([somewhere((3, 4), (11, 15))], reach=2)
    for device in range(2):
        assert torch.equal(window.walled[device], grid.walled[:, window.cells[device]])


def test_a_window_sees_the_moments_of_the_whole() -> None:
    beliefs = moved(somewhere((6, 7), (10, 8)), torch.zeros(2, 2, 2), torch.full((2, 2), 0.4))
    everywhere = Window.whole(GRID, 2)
    window = everywhere.around([beliefs], reach=0)
    for part, whole in zip(
        window.moments(window.cut(beliefs, everywhere).sum(1).double()),
        GRID.moments(beliefs.sum(1).double()),
        strict=True,
    ):
        torch.testing.assert_close(part, whole, atol=1e-9, rtol=0)
