from __future__ import annotations

import numpy as np
import pytest

from fploc.calibration.link_offset import LinkOffsets, LinkOffsetSettings, running_link_offsets
from fploc.datasets.recordings import Bools, Floats

SETTINGS = LinkOffsetSettings(
    prior_sd_m=1.0, spread_m=1.5, correlation_s=5.0, nearest_m=5.0, reach_m=5.0, step_m=0.05
)
NUMBER = 600


def walk(seed: int = 0) -> tuple[Floats, tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Times, true positions and unit covariances of two devices that pass each other."""
    random = np.random.default_rng(seed)
    t_s = np.cumsum(random.uniform(0.4, 0.6, NUMBER))
    first = np.stack([np.linspace(-10, 10, NUMBER), np.full(NUMBER, 2.0)], axis=1)
    second = np.stack([np.linspace(10, -10, NUMBER), np.full(NUMBER, -1.0)], axis=1)
    covariances = np.tile(np.eye(2), (NUMBER, 1, 1))
    return t_s, (first, second), (covariances, covariances)


def offsets(
    planted_m: float, *, noise_m: float = 0.0, outliers: bool = False, usable: Bools | None = None
) -> LinkOffsets:
    t_s, positions, covariances = walk()
    random = np.random.default_rng(1)
    ranges = np.linalg.norm(positions[0] - positions[1], axis=1) + planted_m
    ranges += noise_m * random.standard_normal(NUMBER)
    if outliers:
        ranges[::5] += 20.0
    there = np.ones(NUMBER, dtype=np.bool_) if usable is None else usable
    return running_link_offsets(t_s, ranges, positions, covariances, there, prior_m=1.0, settings=SETTINGS)


@pytest.mark.parametrize("planted_m", [0.2, 1.0, 2.5, 4.0])
def test_it_converges_to_a_planted_offset(planted_m: float) -> None:
    found = offsets(planted_m, noise_m=1.0)
    assert found.means_m[-1] == pytest.approx(planted_m, abs=0.25)
    assert found.sds_m[-1] < 0.35 < found.sds_m[0]


def test_it_begins_at_the_prior_and_stays_there_where_devices_have_no_fixes() -> None:
    found = offsets(4.0, usable=np.zeros(NUMBER, dtype=np.bool_))
    assert found.means_m.shape == found.sds_m.shape == (NUMBER + 1,)
    np.testing.assert_allclose(found.means_m, 1.0, atol=1e-9)
    np.testing.assert_allclose(found.sds_m, SETTINGS.prior_sd_m, atol=1e-2)


def test_it_is_causal() -> None:
    """What comes later changes nothing of what was known before."""
    t_s, positions, covariances = walk()
    ranges = np.linalg.norm(positions[0] - positions[1], axis=1) + 2.0
    there = np.ones(NUMBER, dtype=np.bool_)
    half = NUMBER // 2
    spoilt = np.where(np.arange(NUMBER) < half, ranges, 50.0)
    one, other = (
        running_link_offsets(t_s, given, positions, covariances, there, prior_m=1.0, settings=SETTINGS)
        for given in (ranges, spoilt)
    )
    np.testing.assert_array_equal(one.means_m[: half + 1], other.means_m[: half + 1])
    assert one.means_m[-1] != other.means_m[-1]


def test_a_fifth_of_readings_far_too_long_moves_it_little() -> None:
    assert offsets(2.0, noise_m=0.5, outliers=True).means_m[-1] == pytest.approx(2.0, abs=0.5)


def test_fixes_that_lie_together_say_nothing() -> None:
    t_s, (first, _), covariances = walk()
    near = first + np.array([SETTINGS.nearest_m / 2, 0.0])
    there = np.ones(NUMBER, dtype=np.bool_)
    found = running_link_offsets(
        t_s, np.full(NUMBER, 9.0), (first, near), covariances, there, prior_m=1.0, settings=SETTINGS
    )
    np.testing.assert_allclose(found.means_m, 1.0, atol=1e-9)


def test_readings_that_crowd_count_as_one() -> None:
    """Ten times the readings in the same time tell no more: errors of fixes last for seconds."""
    t_s, positions, covariances = walk()
    ranges = np.linalg.norm(positions[0] - positions[1], axis=1) + 3.0
    there = np.ones(NUMBER, dtype=np.bool_)

    def last_sd(every: int) -> float:
        at = slice(None, None, every)
        found = running_link_offsets(
            t_s[at], ranges[at], (positions[0][at], positions[1][at]),
            (covariances[0][at], covariances[1][at]), there[at], prior_m=1.0, settings=SETTINGS,
        )  # fmt: skip
        return float(found.sds_m[-1])

    assert last_sd(1) == pytest.approx(last_sd(10), rel=0.1)


def test_the_device_that_is_named_first_does_not_matter() -> None:
    t_s, (first, second), covariances = walk()
    ranges = np.linalg.norm(first - second, axis=1) + 2.0
    there = np.ones(NUMBER, dtype=np.bool_)
    one, other = (
        running_link_offsets(t_s, ranges, pair, covariances, there, prior_m=1.0, settings=SETTINGS)
        for pair in ((first, second), (second, first))
    )
    np.testing.assert_allclose(one.means_m, other.means_m)
