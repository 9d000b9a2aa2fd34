from __future__ import annotations

import numpy as np
import pytest
import torch

from fploc.filters.kalman import BatchedFilter, KalmanSettings, TrackFilter, process_noise, transition
from fploc.intervals import Estimate, NoFix, estimate

STEPS, DEVICES = 80, 5
SETTINGS = [
    KalmanSettings(),
    KalmanSettings.for_speed(1.4),
    KalmanSettings(measurement_variance_m2=None, rejects_to_restart=3),
]


def fixes_at(positions: torch.Tensor, fixed: torch.Tensor, variance: float = 1.0) -> Estimate:
    covariances = (variance * torch.eye(2, dtype=torch.float64)).expand(len(positions), 2, 2)
    reasons = torch.where(fixed, int(NoFix.FIXED), int(NoFix.TOO_FEW_RANGES))
    return estimate(positions, covariances, reasons)


def walk(seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return times (T, B), fixes (T, B, 2) with outliers and jumps, fixed and present (T, B)."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.rand(STEPS, DEVICES, generator=generator, dtype=torch.float64)
    t_s = steps.cumsum(0)
    positions = torch.randn(STEPS, DEVICES, 2, generator=generator, dtype=torch.float64) + t_s[..., None]
    outliers = torch.rand(STEPS, DEVICES, generator=generator) < 0.1
    positions[outliers] += 40.0
    positions[STEPS // 2 :, 1] += 25.0
    fixed = torch.rand(STEPS, DEVICES, generator=generator) < 0.8
    present = torch.arange(STEPS)[:, None] < torch.tensor([STEPS, 70, 40, 80, 1])
    return t_s, positions, fixed, present


@pytest.mark.parametrize("settings", SETTINGS)
def test_batched_filter_equals_filterpy(settings: KalmanSettings) -> None:
    t_s, positions, fixed, present = walk(0)
    batched = BatchedFilter(settings)
    state = batched.init(DEVICES)
    tracks = [TrackFilter(settings) for _ in range(DEVICES)]
    compared = 0
    for step in range(STEPS):
        fixes = fixes_at(positions[step], fixed[step], variance=0.7 + step % 3)
        state, found = batched.step(state, t_s[step], present[step], fixes)
        for index, track in enumerate(tracks):
            if not present[step, index]:
                continue
            has_fix = bool(fixed[step, index])
            expected = track.step(
                float(t_s[step, index]),
                positions[step, index].numpy() if has_fix else None,
                fixes.covariances[index].numpy() if has_fix else None,
            )
            assert (expected is not None) == bool(state.started[index])
            if expected is None:
                continue
            np.testing.assert_allclose(state.means[index, :2], expected[0], atol=1e-9, rtol=0)
            np.testing.assert_allclose(state.covariances[index, :2, :2], expected[1], atol=1e-9, rtol=0)
            assert bool(found.fixed[index]) == has_fix
            compared += 1
    assert compared > 200


def test_noise_of_two_steps_is_that_of_their_sum() -> None:
    one, two = torch.tensor([0.3]).double(), torch.tensor([0.9]).double()
    first, second, both = process_noise(one, 0.3), process_noise(two, 0.3), process_noise(one + two, 0.3)
    torch.testing.assert_close(transition(two) @ first @ transition(two).mT + second, both)


def test_it_follows_a_straight_walk_better_than_its_fixes() -> None:
    generator = torch.Generator().manual_seed(2)
    t_s = torch.arange(300, dtype=torch.float64) * 0.4
    truth = torch.stack([0.5 * t_s, 3.0 - 0.2 * t_s], -1)
    fixes = truth + torch.randn(300, 2, generator=generator, dtype=torch.float64)
    batched = BatchedFilter(KalmanSettings())
    state, errors = batched.init(1), []
    here = torch.ones(1, dtype=torch.bool)
    for step in range(300):
        state, found = batched.step(state, t_s[step : step + 1], here, fixes_at(fixes[step : step + 1], here))
        errors.append(torch.dist(found.positions[0], truth[step]))
    unfiltered = (fixes - truth)[50:].norm(dim=-1)
    assert torch.stack(errors[50:]).square().mean() < 0.5 * unfiltered.square().mean()
    torch.testing.assert_close(state.means[0, 2:], torch.tensor([0.5, -0.2]).double(), atol=0.5, rtol=0)


def test_an_interval_without_a_fix_stays_without_one_and_the_track_goes_on() -> None:
    batched = BatchedFilter(KalmanSettings())
    here = torch.ones(1, dtype=torch.bool)
    nowhere = torch.full((1, 2), torch.nan, dtype=torch.float64)
    state, found = batched.step(batched.init(1), torch.tensor([0.0]), here, fixes_at(nowhere, ~here))
    assert found.reasons.tolist() == [NoFix.TOO_FEW_RANGES] and found.positions.isnan().all()
    place = torch.tensor([[5.0, 6.0]], dtype=torch.float64)
    state, found = batched.step(state, torch.tensor([1.0]), here, fixes_at(place, here))
    torch.testing.assert_close(found.positions, place)
    state, found = batched.step(state, torch.tensor([9.0]), here, fixes_at(nowhere, ~here))
    assert not found.fixed.any()
    torch.testing.assert_close(state.means[:, :2], place)
    assert torch.isfinite(state.covariances).all() and state.covariances[0, 0, 0] > 10


def test_outliers_are_gated_until_they_agree() -> None:
    settings = KalmanSettings(rejects_to_restart=3)
    batched = BatchedFilter(settings)
    here = torch.ones(1, dtype=torch.bool)
    state = batched.init(1)
    home, away = torch.zeros(1, 2, dtype=torch.float64), torch.full((1, 2), 50.0, dtype=torch.float64)
    seen = []
    for step, place in enumerate([home, home, away, away, home, away, away, away]):
        state, found = batched.step(state, torch.tensor([0.2 * step]), here, fixes_at(place, here))
        seen.append(bool(found.positions.norm() > 30))
    assert seen == [False] * 7 + [True]


def test_absent_devices_and_times_that_step_back_change_no_track() -> None:
    batched = BatchedFilter(KalmanSettings())
    both = torch.ones(2, dtype=torch.bool)
    state, _ = batched.step(
        batched.init(2), torch.tensor([3.0, 3.0]), both, fixes_at(torch.ones(2, 2).double(), both)
    )
    after, _ = batched.step(
        state,
        torch.tensor([4.0, 1.0]),
        torch.tensor([False, True]),
        fixes_at(torch.ones(2, 2).double(), ~both),
    )
    torch.testing.assert_close(after.means, state.means)
    torch.testing.assert_close(after.covariances, state.covariances)
    assert after.t_s.tolist() == [3.0, 3.0]


def test_the_speed_prior_sets_start_and_noise() -> None:
    assert KalmanSettings.for_speed(0.5) == KalmanSettings()
    fast = KalmanSettings.for_speed(1.0)
    assert fast.speed_sd_mps == 1.0 and fast.noise_m2_per_s3 == pytest.approx(1.2)
