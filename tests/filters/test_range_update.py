from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fploc.filters.kalman import BatchedFilter, KalmanSettings
from fploc.filters.range_update import RangedFilter, RangedState, Ranges
from fploc.intervals import Estimate, NoFix

SETTINGS = KalmanSettings(gate=1e9, correlation_s=1e-3)
ANCHORS = torch.tensor([[0.0, 0.0], [20.0, 0.0], [20.0, 15.0], [0.0, 15.0]], dtype=torch.float64)
TRUTH = torch.tensor([6.0, 4.0], dtype=torch.float64)
NOWHERE = Estimate(
    positions=torch.full((1, 2), torch.nan, dtype=torch.float64),
    covariances=torch.full((1, 2, 2), torch.nan, dtype=torch.float64),
    reasons=torch.tensor([int(NoFix.TOO_FEW_RANGES)]),
)
PRESENT = torch.ones(1, dtype=torch.bool)


def fix(position: Tensor, variance_m2: float = 1.0) -> Estimate:
    covariance = variance_m2 * torch.eye(2, dtype=torch.float64)
    return Estimate(position[None], covariance[None], torch.tensor([int(NoFix.FIXED)]))


def ranges(there: list[bool], variance_m2: float = 1e-6, anchors: Tensor = ANCHORS) -> Ranges:
    return Ranges(
        anchors=anchors[None],
        ranges=(anchors - TRUTH).norm(dim=-1)[None],
        variances=torch.full((1, len(anchors)), variance_m2, dtype=torch.float64),
        anchor_covariances=torch.zeros(1, len(anchors), 2, 2, dtype=torch.float64),
        there=torch.tensor([there]),
    )


def started(settings: KalmanSettings = SETTINGS) -> tuple[RangedFilter, RangedState]:
    tracker = RangedFilter(settings, 1e-3)
    begun = tracker.step(tracker.init(1), torch.zeros(1), PRESENT, fix(TRUTH + 1.0), ranges([False] * 4))
    return tracker, begun[0]


def test_without_ranges_it_is_the_filter_on_fixes() -> None:
    tracker, plain = RangedFilter(SETTINGS, 1e-3), BatchedFilter(SETTINGS)
    state, expected = tracker.init(1), plain.init(1)
    for step, shown in enumerate([fix(TRUTH), NOWHERE, fix(TRUTH + 0.5)]):
        t_s = torch.tensor([float(step)])
        state, found = tracker.step(state, t_s, PRESENT, shown, ranges([False] * 4))
        expected, wanted = plain.step(expected, t_s, PRESENT, shown)
        torch.testing.assert_close(found.positions, wanted.positions, equal_nan=True)
        torch.testing.assert_close(found.covariances, wanted.covariances, equal_nan=True)
        assert torch.equal(found.reasons, wanted.reasons)


def test_exact_ranges_lead_to_the_truth() -> None:
    tracker, state = started()
    for step in range(1, 9):
        state, found = tracker.step(state, torch.tensor([float(step)]), PRESENT, NOWHERE, ranges([True] * 4))
    assert found.fixed.all()
    assert torch.dist(found.positions[0], TRUTH) < 1e-3


def test_two_ranges_suffice_where_the_track_knows_the_side() -> None:
    """Ranges to the two lower corners fit the truth and its mirror image below them."""
    tracker, state = started()
    for step in range(1, 9):
        t_s = torch.tensor([float(step)])
        state, found = tracker.step(state, t_s, PRESENT, NOWHERE, ranges([True, True, False, False]))
    assert torch.dist(found.positions[0], TRUTH) < 1e-3


def test_a_range_narrows_along_its_direction_alone() -> None:
    tracker, state = started()
    right = torch.tensor([[20.0, 5.0]], dtype=torch.float64)
    on_a_line = replace(state, tracks=replace(state.tracks, means=torch.tensor([[7.0, 5.0, 0, 0]]).double()))
    _, before = tracker.step(on_a_line, torch.zeros(1), PRESENT, NOWHERE, ranges([False], anchors=right))
    _, after = tracker.step(on_a_line, torch.zeros(1), PRESENT, NOWHERE, ranges([True], anchors=right))
    assert after.covariances[0, 0, 0] < 1e-3 < state.tracks.covariances[0, 0, 0]
    torch.testing.assert_close(after.covariances[0, 1, 1], state.tracks.covariances[0, 1, 1])
    assert not before.fixed.any() and after.fixed.all()


def test_the_scalar_update_is_the_closed_form() -> None:
    tracker, state = started()
    variance, known = 0.7, 0.3
    given = ranges([True], variance, anchors=torch.tensor([[6.0, -10.0]], dtype=torch.float64))
    given = replace(given, anchor_covariances=known * torch.eye(2, dtype=torch.float64)[None, None])
    _, found = tracker.step(state, torch.zeros(1), PRESENT, NOWHERE, given)
    mean, covariance = state.tracks.means[0], state.tracks.covariances[0]
    away = mean[:2] - given.anchors[0, 0]
    slope = torch.cat([away / away.norm(), torch.zeros(2, dtype=torch.float64)])
    spread = slope @ covariance @ slope + variance + known
    gain = covariance @ slope / spread
    expected = mean + gain * (given.ranges[0, 0] - away.norm())
    torch.testing.assert_close(found.positions[0], expected[:2])
    torch.testing.assert_close(
        found.covariances[0], (covariance - torch.outer(gain, slope @ covariance))[:2, :2]
    )


def test_no_track_starts_at_a_range() -> None:
    tracker = RangedFilter(SETTINGS, 1e-3)
    _, found = tracker.step(tracker.init(1), torch.zeros(1), PRESENT, NOWHERE, ranges([True] * 4))
    assert found.reasons.tolist() == [NoFix.TOO_FEW_RANGES]


def test_an_absent_device_keeps_its_state() -> None:
    tracker, state = started()
    absent = torch.zeros(1, dtype=torch.bool)
    after, _ = tracker.step(state, torch.ones(1), absent, NOWHERE, ranges([True] * 4))
    torch.testing.assert_close(after.tracks.means, state.tracks.means)
    torch.testing.assert_close(after.ranged_t_s, state.ranged_t_s)


@pytest.mark.parametrize("wrong_m", [20.0, 60.0])
def test_a_range_far_off_is_believed_the_less_the_farther_it_is(wrong_m: float) -> None:
    moves = []
    for gate in (9.0, 1e9):
        tracker, state = started(KalmanSettings(gate=gate))
        given = ranges([True, False, False, False], 1.0)
        given = replace(given, ranges=given.ranges + wrong_m)
        _, found = tracker.step(state, torch.ones(1), PRESENT, NOWHERE, given)
        moves.append(float(torch.dist(found.positions[0], state.tracks.means[0, :2])))
    guarded, plain = moves
    assert guarded < 60.0 / wrong_m < plain


def test_ranges_that_crowd_count_as_one() -> None:
    """Ten within a second tell about as much of the position as one does."""
    spreads = []
    for number in (1, 10):
        tracker = RangedFilter(SETTINGS, correlation_s=1.0)
        state = tracker.step(started()[1], torch.zeros(1), PRESENT, NOWHERE, ranges([True] * 4, 1.0))[0]
        for step in range(number):
            t_s = torch.tensor([(step + 1) / number], dtype=torch.float64)
            state, found = tracker.step(state, t_s, PRESENT, NOWHERE, ranges([True] * 4, 1.0))
        spreads.append(float(found.covariances[0].trace()))
    assert spreads[1] == pytest.approx(spreads[0], rel=0.25)


def test_the_order_of_places_does_not_matter() -> None:
    tracker, state = started()
    given, order = ranges([True, True, True, False], 0.5), torch.tensor([3, 1, 0, 2])
    mixed = Ranges(*(getattr(given, name)[:, order] for name in given.__dataclass_fields__))
    one, other = (tracker.step(state, torch.ones(1), PRESENT, NOWHERE, which)[1] for which in (given, mixed))
    torch.testing.assert_close(one.positions, other.positions)
    torch.testing.assert_close(one.covariances, other.covariances)
