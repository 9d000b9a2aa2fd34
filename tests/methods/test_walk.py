from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fploc.methods.walk import Strides, Walk, WalkSettings

SETTINGS = WalkSettings(
    speed_prior_mps=1.0,
    headings=8,
    pace=1.2,
    unsteady_s=0.3,
    dawdling_s=0.4,
    keeps_s=5.0,
    walking_share=0.4,
)
WALK = Walk(SETTINGS)
CELL_M, CELLS = 0.5, 121
CENTRES_M = CELL_M * (torch.arange(CELLS, dtype=torch.float64) - CELLS // 2)


def in_the_middle(gait: int | None) -> torch.Tensor:
    """Return beliefs of one device in the middle of the grid, of one gait or of all at their shares."""
    place = torch.zeros(1, CELLS, CELLS, dtype=torch.float64)
    place[0, CELLS // 2, CELLS // 2] = 1.0
    if gait is None:
        return WALK.begun(place).double()
    beliefs = torch.zeros(1, 1 + SETTINGS.headings, CELLS, CELLS, dtype=torch.float64)
    beliefs[:, gait] = place
    return beliefs


def mean_m(beliefs: torch.Tensor) -> tuple[float, float]:
    total = beliefs[0].sum(0)
    return float(total.sum(1) @ CENTRES_M), float(total.sum(0) @ CENTRES_M)


def variance_m2(beliefs: torch.Tensor) -> float:
    total, mean = beliefs[0].sum(0), mean_m(beliefs)[0]
    return float(total.sum(1) @ (CENTRES_M - mean).square())


def strides(*dt_s: float, cells: int = CELLS) -> Strides:
    return WALK.strides(torch.tensor(dt_s, dtype=torch.float64), CELL_M, farthest=cells)


def after(beliefs: torch.Tensor, dt_s: float) -> torch.Tensor:
    return strides(dt_s).on((CELLS, CELLS)).onwards(beliefs)


def test_a_belief_begins_with_every_gait_at_its_share() -> None:
    begun = WALK.begun(torch.full((2, 3, 4), 1 / 12, dtype=torch.float64))
    assert begun.dtype is torch.float32
    shares = begun.sum((2, 3))
    expected = torch.tensor([[0.6, *[0.05] * 8]]).expand(2, 9)
    torch.testing.assert_close(shares, expected)


@given(st.floats(0.05, 8.0))
def test_nobody_is_lost_and_nobody_drifts(dt_s: float) -> None:
    there = after(in_the_middle(None), dt_s)
    assert (there >= 0).all()
    assert float(there.sum()) == pytest.approx(1.0, abs=1e-3)
    assert mean_m(there) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("dt_s", [0.4, 2.0, 10.0])
@pytest.mark.parametrize("gait", [1, 2, 4, 8])
def test_a_walker_goes_on_by_the_mean_of_a_kept_heading(gait: int, dt_s: float) -> None:
    angle = 2 * math.pi * (gait - 1) / SETTINGS.headings
    ahead = 1.2 * SETTINGS.keeps_s * (1 - math.exp(-dt_s / SETTINGS.keeps_s))
    kept = after(in_the_middle(gait), dt_s)
    # Who takes another gait has come as far until then.
    assert mean_m(kept) == pytest.approx((ahead * math.cos(angle), ahead * math.sin(angle)), abs=5e-3)


@pytest.mark.parametrize("dt_s", [0.4, 3.0])
def test_who_dawdles_strays_like_a_random_walk(dt_s: float) -> None:
    assert variance_m2(after(in_the_middle(0), dt_s)) == pytest.approx(0.4 * dt_s, rel=2e-2)


def test_meanders_are_those_of_a_heading_kept_for_a_time() -> None:
    """Mean square of a path whose heading is forgotten exponentially (Fürth 1920), halved over two axes."""
    tau, dt_s = SETTINGS.keeps_s, 10.0
    ahead = tau * (1 - math.exp(-dt_s / tau))
    square = 1.2**2 * (tau * (dt_s - ahead) - ahead**2 / 2)
    strays = 0.3 * 1.2**2 * dt_s
    assert variance_m2(after(in_the_middle(1), dt_s)) == pytest.approx(square + strays, rel=2e-2)


def test_gaits_are_forgotten_in_their_time() -> None:
    shares = after(in_the_middle(1), SETTINGS.keeps_s).sum((2, 3))[0]
    assert float(shares[1]) == pytest.approx(math.exp(-1) + (1 - math.exp(-1)) * 0.05, abs=1e-3)
    assert float(shares[0]) == pytest.approx((1 - math.exp(-1)) * 0.6, abs=1e-3)


def test_the_mean_speed_is_that_of_the_gaits() -> None:
    mixed = torch.cat([in_the_middle(0), in_the_middle(3), in_the_middle(None)])
    assert WALK.mean_speeds_mps(mixed).tolist() == pytest.approx([0.0, 1.2, 0.48], abs=1e-6)


def test_devices_do_not_mix() -> None:
    both = torch.cat([in_the_middle(1), in_the_middle(5)])
    together = strides(0.4, 2.0).on((CELLS, CELLS)).onwards(both)
    for device, (gait, dt_s) in enumerate([(1, 0.4), (5, 2.0)]):
        alone = after(in_the_middle(gait), dt_s)[0]
        torch.testing.assert_close(together[device], alone, atol=1e-6, rtol=0)


def test_looking_back_is_the_adjoint_of_going_on() -> None:
    generator = torch.Generator().manual_seed(0)
    before, after_them = torch.rand(2, 2, 9, 13, 11, generator=generator, dtype=torch.float64)
    way = strides(0.4, 3.0, cells=13).on((13, 11))
    onwards = (way.onwards(before) * after_them).sum((1, 2, 3))
    back = (before * way.looked_back(after_them)).sum((1, 2, 3))
    torch.testing.assert_close(onwards, back, atol=0, rtol=1e-9)


def test_nobody_gets_beyond_the_reach() -> None:
    beliefs = in_the_middle(1) + in_the_middle(3)
    there = after(beliefs, 2.0).sum((0, 1)) > 0
    reach, middle = strides(2.0).reach, CELLS // 2
    for axis in (0, 1):
        (at,) = torch.nonzero(there.any(axis), as_tuple=True)
        assert int((at - middle).abs().max()) <= reach < middle
