from __future__ import annotations

import math

import numpy as np
import pytest

from fploc.evaluation.metrics import (
    Scores,
    arc_length_m,
    bootstrap_difference,
    held_positions,
    mean_over_recordings,
    normalised_errors,
    score,
    score_errors,
)
from fploc.intervals import NoFix
from fploc.localizer import Path

NAN = float("nan")


def path_of(positions: list[tuple[float, float]], variance: float = 1.0) -> Path:
    """Return a path; NaN marks an interval without a fix."""
    points = np.array(positions, dtype=np.float64).reshape(-1, 2)
    fixed = np.isfinite(points).all(axis=1)
    covariances = np.where(fixed[:, None, None], variance * np.eye(2), np.nan)
    reasons = np.where(fixed, int(NoFix.FIXED), int(NoFix.TOO_FEW_RANGES))
    return Path(points, covariances, reasons, ms_per_fix=0.1)


def labels(count: int) -> np.ndarray:
    return np.zeros((count, 2))


# Errors held: (none) 3 3 4 4; of its own fixes: 3 4.
GAPPY = path_of([(NAN, NAN), (3.0, 0.0), (NAN, NAN), (0.0, 4.0), (NAN, NAN)])


def test_the_last_fix_is_held() -> None:
    np.testing.assert_array_equal(
        held_positions(GAPPY), [[NAN, NAN], [3.0, 0.0], [3.0, 0.0], [0.0, 4.0], [0.0, 4.0]]
    )


def test_scores_count_from_the_first_fix_on() -> None:
    found = score([GAPPY], [labels(5)])
    assert (found.n, found.n_before_first_fix) == (4, 1)
    assert found.no_fix_share == 0.5
    assert found.rmse_m == pytest.approx(math.sqrt((9 + 9 + 16 + 16) / 4))
    assert found.rmse_fixed_m == pytest.approx(math.sqrt((9 + 16) / 2))
    assert found.mae_m == found.p50_m == pytest.approx(3.5)
    assert found.p90_m == found.p95_m == pytest.approx(4.0)
    assert found.nees == pytest.approx((9 + 16) / 2)
    assert found.coverage95 == 0.0


def test_recordings_are_pooled_and_nothing_is_held_across_them() -> None:
    found = score([GAPPY, path_of([(NAN, NAN), (1.0, 0.0)])], [labels(5), labels(2)])
    assert (found.n, found.n_before_first_fix) == (5, 2)
    assert found.rmse_fixed_m == pytest.approx(math.sqrt((9 + 16 + 1) / 3))


def test_intervals_without_a_label_are_left_out() -> None:
    truth = labels(5)
    truth[3] = NAN
    found = score([GAPPY], [truth])
    assert (found.n, found.n_before_first_fix) == (3, 1)
    assert found.rmse_fixed_m == pytest.approx(3.0)


@pytest.mark.parametrize("path", [path_of([(NAN, NAN)] * 3), path_of([])])
def test_without_a_fix_there_is_nothing_to_score(path: Path) -> None:
    found = score([path], [labels(len(path.reasons))])
    assert (found.n, found.n_before_first_fix) == (0, len(path.reasons))
    assert all(math.isnan(getattr(found, name)) for name in ("rmse_m", "p95_m", "nees", "no_fix_share"))


def test_honest_covariances_have_a_nees_of_two_and_cover_95_percent() -> None:
    random = np.random.default_rng(0)
    spread = np.array([[4.0, 1.5], [1.5, 1.0]])
    points = random.multivariate_normal([0, 0], spread, size=20000)
    path = Path(points, np.broadcast_to(spread, (20000, 2, 2)), np.zeros(20000, dtype=np.int64), 0.1)
    found = score([path], [labels(20000)])
    assert found.nees == pytest.approx(2.0, abs=0.05)
    assert found.coverage95 == pytest.approx(0.95, abs=0.005)
    assert normalised_errors(path, labels(20000)).shape == (20000,)


def test_recordings_weigh_alike_or_by_their_length() -> None:
    one, other = (score([path_of([(error, 0.0)] * n)], [labels(n)]) for error, n in ((1.0, 10), (4.0, 2)))
    alike = mean_over_recordings([one, other])
    assert alike.rmse_m == pytest.approx(2.5) and alike.n == 12
    assert mean_over_recordings([one, other], [3.0, 1.0]).rmse_m == pytest.approx(1.75)


def test_a_recording_without_a_fix_does_not_spoil_the_mean() -> None:
    silent = score([path_of([(NAN, NAN)] * 3)], [labels(3)])
    fixed = score([path_of([(1.0, 0.0)])], [labels(1)])
    found = mean_over_recordings([silent, fixed])
    assert found.rmse_m == 1.0 and (found.n, found.n_before_first_fix) == (1, 3)
    assert math.isnan(mean_over_recordings([silent]).rmse_m)
    assert isinstance(found, Scores)


def test_arc_length_skips_gaps_in_the_labels() -> None:
    truth = np.array([[0.0, 0.0], [3.0, 4.0], [NAN, NAN], [3.0, 5.0]])
    assert arc_length_m(truth) == pytest.approx(6.0)


def test_errors_alone_give_the_scores_that_need_nothing_else() -> None:
    found, whole = score_errors(np.array([NAN, 3.0, 3.0, 4.0, 4.0, NAN])), score([GAPPY], [labels(5)])
    for name in ("n", "rmse_m", "mae_m", "p50_m", "p90_m", "p95_m"):
        assert getattr(found, name) == getattr(whole, name)
    assert math.isnan(found.rmse_fixed_m) and math.isnan(found.coverage95) and math.isnan(found.nees)


def seconds(*lengths: int) -> list[np.ndarray]:
    return [np.arange(length, dtype=np.float64) for length in lengths]


def test_the_difference_is_that_of_the_two_rmse() -> None:
    first = [np.array([3.0, 4.0, NAN]), np.array([0.0])]
    second = [np.array([1.0, 2.0, 50.0]), np.array([2.0])]
    found = bootstrap_difference(first, second, seconds(3, 1))
    assert found.rmse_m == pytest.approx(math.sqrt(25 / 3) - math.sqrt(9 / 3))
    assert found.recordings_m == pytest.approx((math.sqrt(12.5) - math.sqrt(2.5), -2.0))


def test_one_block_or_equal_blocks_leave_nothing_to_chance() -> None:
    one = bootstrap_difference([np.array([1.0, 3.0])], [np.array([1.0, 1.0])], seconds(2))
    assert one.low_m == one.high_m == one.rmse_m
    constant = bootstrap_difference([np.full(300, 2.0)], [np.full(300, 0.5)], seconds(300))
    assert (constant.low_m, constant.rmse_m, constant.high_m) == pytest.approx((1.5, 1.5, 1.5))


def test_errors_that_stay_for_a_block_make_the_difference_less_sure_than_their_number_says() -> None:
    draws = np.random.default_rng(0).exponential(size=40)
    lasting = [np.repeat(draws, 30)]
    zero, times = [np.zeros(1200)], seconds(1200)
    by_block = bootstrap_difference(lasting, zero, times)
    by_interval = bootstrap_difference(lasting, zero, times, block_s=1.0)
    assert by_block.rmse_m == pytest.approx(by_interval.rmse_m)
    assert by_block.high_m - by_block.low_m > 3.0 * (by_interval.high_m - by_interval.low_m)
    assert by_block == bootstrap_difference(lasting, zero, times)


def test_blocks_end_with_their_recording() -> None:
    first = [np.full(10, 1.0), np.full(10, 3.0)]
    found = bootstrap_difference(first, [np.zeros(10), np.zeros(10)], seconds(10, 10))
    assert (found.low_m, found.high_m) == pytest.approx((1.0, 3.0))


def test_nothing_in_common_is_no_number() -> None:
    found = bootstrap_difference([np.array([NAN])], [np.array([1.0])], seconds(1))
    assert math.isnan(found.rmse_m) and found.recordings_m == ()
