from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from fploc.intervals import Intervals, NoFix
from fploc.methods.bayes_grid import BayesGrid, BayesGridSettings
from rooms import room

CORNERS = [(0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0)]
SITE = room(CORNERS)
COARSE = replace(BayesGridSettings.read(), cell_m=0.5, margin_m=2.0)


def interval(ranges: list[list[float]], t_s: float = 0.0) -> Intervals:
    measured = torch.tensor(ranges, dtype=torch.float64)
    return Intervals(
        t_s=torch.full((len(ranges),), t_s, dtype=torch.float64),
        ranges=measured,
        stds=torch.zeros_like(measured),
        rss=torch.zeros_like(measured),
        heard=measured > 0,
        present=torch.ones(len(ranges), dtype=torch.bool),
    )


def log_density(measured: float, distance: float, model: BayesGridSettings) -> float:
    """The observation model as rivals.md writes it, one number at a time."""
    ratio = (measured - model.bias_m) / distance
    log_f = 0.0
    if ratio < model.ratio_low:
        log_f = (ratio - model.ratio_low) / model.scale_low
    elif ratio > model.ratio_high:
        log_f = -(ratio - model.ratio_high) / model.scale_high
    width = model.scale_low + model.ratio_high - model.ratio_low + model.scale_high
    return log_f - math.log(distance * width)


def test_one_interval_is_the_product_of_the_stated_densities() -> None:
    method = BayesGrid(COARSE)
    measured = [5.1, 7.2, 0.0, 4.9]
    state, found = method.step(method.init(SITE, 1), interval([measured]))
    logs = np.zeros((len(state.grid.xs_m), len(state.grid.ys_m)))
    for row, x in enumerate(state.grid.xs_m.tolist()):
        for column, y in enumerate(state.grid.ys_m.tolist()):
            for range_m, (ap_x, ap_y) in zip(measured, CORNERS, strict=True):
                if range_m > 0:
                    distance = max(math.hypot(x - ap_x, y - ap_y), COARSE.cell_m / 2)
                    explained = log_density(range_m, distance, COARSE)
                    logs[row, column] += np.logaddexp(explained, math.log(COARSE.floor_per_m))
    expected = np.exp(logs - logs.max())
    expected /= expected.sum()
    np.testing.assert_allclose(state.beliefs[0].numpy(), expected, rtol=1e-4, atol=1e-12)
    mean_x = (expected.sum(1) * state.grid.xs_m.numpy()).sum()
    assert float(found.positions[0, 0]) == pytest.approx(mean_x, abs=1e-4)


def test_the_grid_covers_the_access_points_and_the_margin() -> None:
    state = BayesGrid(COARSE).init(SITE, 3)
    for cells, size in ((state.grid.xs_m, 8.0), (state.grid.ys_m, 6.0)):
        assert float(cells[0]) == -2.0 + 0.25 and float(cells[-1]) == size + 2.0 - 0.25
    torch.testing.assert_close(state.beliefs.sum((1, 2)), torch.ones(3, dtype=torch.float64))


def test_a_gap_longer_than_the_building_leaves_a_belief() -> None:
    method = BayesGrid(COARSE)
    state, _ = method.step(method.init(SITE, 1), interval([[5.1, 7.2, 6.0, 4.9]]))
    state, found = method.step(state, interval([[5.1, 7.2, 6.0, 4.9]], t_s=3600.0))
    assert found.fixed.all() and torch.isfinite(state.beliefs).all()


def test_time_that_steps_back_is_no_time() -> None:
    method = BayesGrid(COARSE)
    state, _ = method.step(method.init(SITE, 1), interval([[5.1, 7.2, 6.0, 4.9]], t_s=9.0))
    still, _ = method.step(state, interval([[5.1, 7.2, 6.0, 4.9]], t_s=9.0))
    back, _ = method.step(state, interval([[5.1, 7.2, 6.0, 4.9]], t_s=4.0))
    torch.testing.assert_close(back.beliefs, still.beliefs)
    assert back.t_s.tolist() == [9.0]


def test_one_access_point_gives_a_wide_fix_and_none_gives_no_fix() -> None:
    method = BayesGrid(COARSE)
    state = method.init(SITE, 2)
    state, none = method.step(state, interval([[0.0] * 4, [0.0] * 4]))
    assert none.reasons.tolist() == [NoFix.NO_READING] * 2
    state, found = method.step(state, interval([[3.0, 0.0, 0.0, 0.0], [0.0] * 4], t_s=0.3))
    assert found.reasons.tolist() == [NoFix.FIXED, NoFix.NO_READING]
    state, whole = method.step(state, interval([[5.1, 7.2, 6.0, 4.9]] * 2, t_s=0.6))
    assert whole.fixed.all()
    assert whole.covariances[0].trace() < found.covariances[0].trace()


def test_the_first_reading_after_silence_meets_a_belief_without_blur() -> None:
    method = BayesGrid(COARSE)
    measured = [[5.1, 7.2, 6.0, 4.9]]
    fresh, _ = method.step(method.init(SITE, 1), interval(measured))
    silent, _ = method.step(method.init(SITE, 1), interval([[0.0] * 4]))
    later, _ = method.step(silent, interval(measured, t_s=500.0))
    torch.testing.assert_close(later.beliefs, fresh.beliefs)


def test_one_wild_range_among_good_ones_moves_little() -> None:
    method = BayesGrid()
    truth = torch.tensor([[3.0, 2.0]], dtype=torch.float64)
    model = method.settings
    distances = torch.cdist(truth, torch.tensor(CORNERS, dtype=torch.float64))
    good = (model.bias_m + distances * (model.ratio_low + model.ratio_high) / 2).tolist()
    state = method.init(SITE, 1)
    for step in range(5):
        state, found = method.step(state, interval(good, t_s=0.3 * step))
    wild = [[*good[0][:3], 500.0]]
    _, after = method.step(state, interval(wild, t_s=1.5))
    assert (after.positions - found.positions).norm() < 0.3


def test_a_device_that_was_carried_away_is_found_again() -> None:
    method = BayesGrid()
    model = method.settings
    places = torch.tensor([[1.0, 1.0], [7.0, 5.0]], dtype=torch.float64)
    distances = torch.cdist(places, torch.tensor(CORNERS, dtype=torch.float64))
    measured = (model.bias_m + distances * (model.ratio_low + model.ratio_high) / 2).tolist()
    state = method.init(SITE, 1)
    for step in range(60):
        state, found = method.step(state, interval([measured[step >= 20]], t_s=0.3 * step))
    assert (found.positions[0] - places[1]).norm() < 0.5


def test_it_asks_for_ranges_as_its_model_was_fitted() -> None:
    assert BayesGrid().default_calibration == "none"
    assert BayesGrid().for_speed(1.4).settings == replace(BayesGrid().settings, speed_prior_mps=1.4)


def test_intervals_in_quick_succession_share_one_likelihood() -> None:
    method = BayesGrid(replace(COARSE, correlation_s=2.0, speed_prior_mps=1e-6))
    measured = [[5.1, 7.2, 6.0, 4.9]]
    fresh = method.init(SITE, 1)
    alone, _ = method.step(fresh, interval(measured))
    soon, _ = method.step(alone, interval(measured, t_s=0.5))
    late, _ = method.step(alone, interval(measured, t_s=2.0))
    likelihood = alone.beliefs / fresh.beliefs
    for after, power in ((soon, 0.25), (late, 1.0)):
        expected = alone.beliefs * likelihood**power
        torch.testing.assert_close(after.beliefs, expected / expected.sum(), atol=1e-9, rtol=1e-6)


def test_silence_between_two_readings_does_not_take_from_the_second() -> None:
    method = BayesGrid(replace(COARSE, correlation_s=2.0))
    state, _ = method.step(method.init(SITE, 1), interval([[5.1, 7.2, 6.0, 4.9]]))
    state, _ = method.step(state, interval([[0.0] * 4], t_s=1.9))
    assert state.heard_t_s.tolist() == [0.0] and state.t_s.tolist() == [1.9]
