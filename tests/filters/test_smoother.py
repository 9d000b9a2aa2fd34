from __future__ import annotations

import numpy as np
import pytest
import torch
from filterpy.kalman import KalmanFilter

from fploc.filters.kalman import BatchedFilter, KalmanSettings, process_noise, transition
from fploc.filters.smoother import smoothed
from fploc.intervals import Estimate, Intervals, NoFix

STEPS = 60
PLAIN = KalmanSettings(gate=1e12, correlation_s=0.0)
"""Every fix is taken at its word, as the textbook's filter takes it."""


def walk(seed: int) -> tuple[Intervals, Estimate, torch.Tensor]:
    """Return intervals of two devices, noisy fixes of a walk with gaps, and the truth (T, B, 2)."""
    generator = torch.Generator().manual_seed(seed)
    t_s = torch.rand(STEPS, 2, generator=generator, dtype=torch.float64).cumsum(0)
    truth = torch.stack([0.5 * t_s, 3 * (t_s / 8).sin()], -1)
    positions = truth + torch.randn(STEPS, 2, 2, generator=generator, dtype=torch.float64)
    fixed = torch.rand(STEPS, 2, generator=generator) < 0.8
    fixed[0] = True
    present = torch.arange(STEPS)[:, None] < torch.tensor([STEPS, 45])
    none = torch.zeros(STEPS, 2, 0, dtype=torch.float64)
    intervals = Intervals(t_s, none, none, none, none.bool(), present)
    covariances = torch.eye(2, dtype=torch.float64).expand(STEPS, 2, 2, 2)
    reasons = torch.where(fixed, int(NoFix.FIXED), int(NoFix.TOO_FEW_RANGES))
    return intervals, Estimate(positions, covariances, reasons), truth


def test_it_is_the_smoother_of_filterpy() -> None:
    intervals, found, _ = walk(0)
    t_s, fixed = intervals.t_s[:, 0], found.fixed[:, 0]
    track = KalmanFilter(dim_x=4, dim_z=2)
    track.H = np.eye(2, 4)
    track.x = np.array([*found.positions[0, 0].tolist(), 0.0, 0.0])[:, None]
    track.P = np.diag([2.0, 2.0, PLAIN.velocity_variance_m2_per_s2, PLAIN.velocity_variance_m2_per_s2])
    means, covariances, flows, noises = [track.x], [track.P], [np.eye(4)], [np.zeros((4, 4))]
    for step in range(1, STEPS):
        dt = (t_s[step] - t_s[step - 1])[None]
        flows.append(transition(dt, PLAIN.turning_s)[0].numpy())
        noises.append(process_noise(dt, PLAIN)[0].numpy())
        track.predict(F=flows[-1], Q=noises[-1])
        if fixed[step]:
            track.update(found.positions[step, 0].numpy()[:, None], R=2 * np.eye(2))
        means.append(track.x)
        covariances.append(track.P)
    # filterpy takes the transition into a step at the index of that step.
    expected, spread, *_ = track.rts_smoother(np.array(means), np.array(covariances), flows, noises)
    ours = smoothed(BatchedFilter(PLAIN), intervals, found)
    np.testing.assert_allclose(ours.positions[:, 0][fixed], expected[fixed.numpy(), :2, 0], atol=1e-8)
    np.testing.assert_allclose(ours.covariances[:, 0][fixed], spread[fixed.numpy(), :2, :2], atol=1e-8)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_errs_less_than_the_filter_and_ends_where_the_filter_ends(seed: int) -> None:
    intervals, found, truth = walk(seed)
    tracker = BatchedFilter(KalmanSettings())
    state, causal = tracker.init(2), []
    for step in range(STEPS):
        fixes = Estimate(found.positions[step], found.covariances[step], found.reasons[step])
        state, one = tracker.step(state, intervals.t_s[step], intervals.present[step], fixes)
        causal.append(one.positions)
    ours = smoothed(tracker, intervals, found)
    both = found.fixed & intervals.present
    before, after = (
        ((one - truth)[both]).square().sum(-1).mean() for one in (torch.stack(causal), ours.positions)
    )
    assert after < 0.8 * before
    torch.testing.assert_close(ours.positions[-1, 0], causal[-1][0], equal_nan=True)
    assert torch.equal(ours.reasons, found.reasons)


def test_a_device_that_comes_late_has_no_past() -> None:
    intervals, found, _ = walk(4)
    late = found.reasons.clone()
    late[:10, 0] = int(NoFix.NO_READING)
    late[10, 0] = int(NoFix.FIXED)
    ours = smoothed(BatchedFilter(PLAIN), intervals, Estimate(found.positions, found.covariances, late))
    alone = smoothed(
        BatchedFilter(PLAIN),
        intervals.at(slice(10, None)),
        Estimate(found.positions[10:], found.covariances[10:], late[10:]),
    )
    assert ours.positions[:10, 0].isnan().all()
    torch.testing.assert_close(ours.positions[10:, 0], alone.positions[:, 0], equal_nan=True)
