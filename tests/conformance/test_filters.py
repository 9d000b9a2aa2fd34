"""One suite over every filter: the interface of ``fploc.filters.interface``."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from fploc.filters.registry import FILTERS
from fploc.intervals import NoFix, estimate

SPEED_MPS = 0.5
STEPS, DEVICES, STEP_S = 60, 4, 0.5
NOISE_M = 1.0


def walks() -> tuple[Tensor, Tensor]:
    """Return straight walks at the prior speed and noisy fixes of them, shape (T, B, 2) each."""
    random = torch.Generator().manual_seed(3)
    headings = torch.rand(DEVICES, generator=random, dtype=torch.float64) * 2 * math.pi
    velocities = SPEED_MPS * torch.stack([headings.cos(), headings.sin()], dim=-1)
    times = STEP_S * torch.arange(STEPS, dtype=torch.float64)
    truth = times[:, None, None] * velocities + torch.tensor([5.0, -3.0])
    return truth, truth + NOISE_M * torch.randn(truth.shape, generator=random, dtype=torch.float64)


def filtered(name: str, positions: Tensor, reasons: Tensor, present: Tensor) -> Tensor:
    """Return the filtered positions, shape (T, B, 2), of fixes with a variance of 1 m² per axis."""
    tracker = FILTERS[name](SPEED_MPS)
    state = tracker.init(positions.shape[1])
    covariances = torch.eye(2, dtype=torch.float64).repeat(positions.shape[1], 1, 1)
    found = []
    for step, now in enumerate(positions):
        t_s = torch.full((len(now),), STEP_S * step, dtype=torch.float64)
        fixes = estimate(now, covariances, reasons[step])
        state, smoothed = tracker.step(state, t_s, present[step], fixes)
        assert torch.equal(smoothed.reasons, fixes.reasons)
        found.append(smoothed.positions)
    return torch.stack(found)


def everything() -> tuple[Tensor, Tensor]:
    """Return reasons and presence, shape (T, B), where every device has a fix at every time."""
    reasons = torch.full((STEPS, DEVICES), int(NoFix.FIXED))
    return reasons, torch.ones(STEPS, DEVICES, dtype=torch.bool)


@pytest.mark.parametrize("name", FILTERS)
def test_a_walk_is_followed_better_than_by_its_fixes(name: str) -> None:
    truth, fixes = walks()
    errors = (filtered(name, fixes, *everything()) - truth)[STEPS // 2 :].norm(dim=-1)
    assert errors.square().mean().sqrt() < 0.8 * NOISE_M * math.sqrt(2)


@pytest.mark.parametrize("name", FILTERS)
def test_the_track_moves_and_turns_with_the_frame(name: str) -> None:
    _, fixes = walks()
    turn = torch.tensor([[0.0, -1.0], [1.0, 0.0]], dtype=torch.float64)
    moved = filtered(name, fixes @ turn.T + 100.0, *everything())
    assert torch.allclose(moved, filtered(name, fixes, *everything()) @ turn.T + 100.0, atol=1e-6)


@pytest.mark.parametrize("name", FILTERS)
def test_devices_do_not_see_each_other(name: str) -> None:
    _, fixes = walks()
    reasons, present = everything()
    alone = filtered(name, fixes[:, 1:2], reasons[:, 1:2], present[:, 1:2])
    assert torch.allclose(alone, filtered(name, fixes, reasons, present)[:, 1:2], atol=1e-12)


@pytest.mark.parametrize("name", FILTERS)
def test_an_absent_device_keeps_its_state(name: str) -> None:
    _, fixes = walks()
    reasons, present = everything()
    present[10:20, 0] = False
    wild = fixes.clone()
    wild[10:20, 0] = 1e6
    after = slice(20, None)
    there, gone = (filtered(name, one, reasons, present)[after] for one in (fixes, wild))
    assert torch.equal(there, gone)


@pytest.mark.parametrize("name", FILTERS)
def test_what_is_no_fix_changes_no_position(name: str) -> None:
    _, fixes = walks()
    reasons, present = everything()
    reasons[10:20, 0] = int(NoFix.NO_READING)
    wild = fixes.clone()
    wild[10:20, 0] = 1e6
    tracks = filtered(name, wild, reasons, present)
    assert torch.isfinite(tracks[20:]).all() and tracks[20:].abs().max() < 100.0
