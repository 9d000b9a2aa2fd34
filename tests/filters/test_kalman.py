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
    KalmanSettings(turning_s=60.0, fix_variance_m2=0.0, gate=2.0, correlation_s=0.0),
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
    settings = KalmanSettings()
    first, second, both = (process_noise(dt_s, settings) for dt_s in (one, two, one + two))
    flow = transition(two, settings.turning_s)
    torch.testing.assert_close(flow @ first @ flow.mT + second, both)
    torch.testing.assert_close(
        flow @ transition(one, settings.turning_s), transition(one + two, settings.turning_s)
    )


def test_in_steps_far_shorter_than_a_turn_the_velocity_is_constant() -> None:
    dt_s, settings = torch.tensor([0.2]).double(), KalmanSettings(turning_s=2000.0)
    flow, noise = transition(dt_s, settings.turning_s)[0], process_noise(dt_s, settings)[0]
    torch.testing.assert_close(flow[0], torch.tensor([1.0, 0.0, 0.2, 0.0]).double(), atol=1e-4, rtol=0)
    expected = settings.noise_m2_per_s3 * torch.tensor([0.2**3 / 3, 0.0, 0.2**2 / 2, 0.0]).double()
    torch.testing.assert_close(noise[0], expected, atol=1e-9, rtol=1e-3)


def test_people_keep_their_speed_and_forget_where_they_walked() -> None:
    settings, long = KalmanSettings.for_speed(1.4), torch.tensor([300.0]).double()
    velocity = process_noise(long, settings)[0, 2:, 2:]
    torch.testing.assert_close(velocity.trace().sqrt(), torch.tensor(1.4).double())
    reach_m = transition(long, settings.turning_s)[0, 0, 2] * 1.4
    torch.testing.assert_close(reach_m, torch.tensor(1.4 * settings.turning_s).double())


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


@pytest.mark.parametrize("settings", SETTINGS)
def test_whole_recordings_at_once_equal_one_interval_after_the_other(settings: KalmanSettings) -> None:
    t_s, positions, fixed, present = walk(3)
    t_s[9] = t_s[7]
    variances = (0.7 + torch.arange(STEPS) % 3).double()
    batched = BatchedFilter(settings)
    state, expected = batched.init(DEVICES), []
    for step in range(STEPS):
        fixes = fixes_at(positions[step], fixed[step], variance=float(variances[step]))
        state, found = batched.step(state, t_s[step], present[step], fixes)
        expected.append(found)
    rows = fixes_at(positions.flatten(0, 1), fixed.flatten())
    together = batched.run(
        t_s,
        present,
        Estimate(
            rows.positions.reshape(STEPS, DEVICES, 2),
            rows.covariances.reshape(STEPS, DEVICES, 2, 2) * variances[:, None, None, None],
            rows.reasons.reshape(STEPS, DEVICES),
        ),
    )
    for name in ("positions", "covariances", "reasons"):
        in_turn = torch.stack([getattr(one, name) for one in expected])
        torch.testing.assert_close(getattr(together, name), in_turn, rtol=0, atol=1e-9, equal_nan=True)
    assert together.fixed.sum() > STEPS


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
    walked = process_noise(torch.tensor([8.0]).double(), batched.settings)[0, 0, 0]
    assert torch.isfinite(state.covariances).all() and state.covariances[0, 0, 0] > walked > 3


def steps_at(places: list[tuple[float, torch.Tensor]], settings: KalmanSettings) -> list[torch.Tensor]:
    """Return the filtered positions of one device for fixes at times."""
    batched, here = BatchedFilter(settings), torch.ones(1, dtype=torch.bool)
    state, seen = batched.init(1), []
    for t_s, place in places:
        state, found = batched.step(state, torch.tensor([t_s]), here, fixes_at(place, here))
        seen.append(found.positions[0])
    return seen


HOME = torch.zeros(1, 2, dtype=torch.float64)


def test_an_outlier_pulls_the_less_the_farther_it_is() -> None:
    pulls = []
    for distance in (3.0, 30.0, 300.0):
        places = [(0.5 * step, HOME) for step in range(10)] + [(5.0, HOME + distance)]
        pulls.append(float(steps_at(places, KalmanSettings())[-1].norm()))
    assert pulls[0] > pulls[1] > pulls[2] > 0
    assert pulls[1] < 0.5


def test_a_wrong_first_fix_is_left_within_half_a_minute() -> None:
    places = [(0.0, HOME + 30.0)] + [(0.5 * step, HOME) for step in range(1, 60)]
    assert steps_at(places, KalmanSettings())[-1].norm() < 0.5


def test_fixes_in_quick_succession_count_as_one() -> None:
    batched, here = BatchedFilter(KalmanSettings()), torch.ones(1, dtype=torch.bool)
    variances = []
    for step_s in (1.0, 0.1):
        state = batched.init(1)
        for index in range(1 + round(10 / step_s)):
            state, _ = batched.step(state, torch.tensor([step_s * index]), here, fixes_at(HOME, here))
        variances.append(float(state.covariances[0, 0, 0]))
    assert variances[1] == pytest.approx(variances[0], rel=0.2)


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
    assert fast.velocity_variance_m2_per_s2 == 0.5
    assert fast.noise_m2_per_s3 == pytest.approx(4 * KalmanSettings().noise_m2_per_s3)
