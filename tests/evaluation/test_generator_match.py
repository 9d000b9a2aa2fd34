from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from fploc.evaluation.generator_match import (
    match_statistics,
    quantile_skewness,
    rank_correlation,
    robust_spread,
)


def quantiles_of(distribution: scipy.stats.rv_frozen, number: int = 100_001) -> np.ndarray:
    """Evenly spaced quantiles: a sample without chance, one column."""
    return np.asarray(distribution.ppf((np.arange(number) + 0.5) / number))[:, None]


def test_spread_is_the_standard_deviation_of_a_normal_distribution() -> None:
    assert robust_spread(quantiles_of(scipy.stats.norm(3.0, 1.7))) == pytest.approx([1.7], rel=1e-4)


def test_spread_is_scipys_and_hardly_moves_with_outliers() -> None:
    values = np.random.default_rng(0).standard_t(3, (501, 4))
    expected = scipy.stats.median_abs_deviation(values, axis=0, scale="normal")
    np.testing.assert_allclose(robust_spread(values), expected, rtol=1e-12)
    far = values.copy()
    far[:5] = 1e6
    np.testing.assert_allclose(robust_spread(far), expected, rtol=0.05)


@pytest.mark.parametrize("scale", [0.5, 4.0])
def test_skewness_of_an_exponential_distribution(scale: float) -> None:
    """p = −ln(1 − q): (ln 10 + ln(10/9) − 2 ln 2) / (ln 10 − ln(10/9)), whatever scale and place."""
    expected = (np.log(10) + np.log(10 / 9) - 2 * np.log(2)) / (np.log(10) - np.log(10 / 9))
    values = quantiles_of(scipy.stats.expon(loc=-3.0, scale=scale))
    assert quantile_skewness(values) == pytest.approx([expected], rel=1e-3)
    assert quantile_skewness(-values) == pytest.approx([-expected], rel=1e-3)


def test_skewness_of_symmetric_and_of_single_values_is_zero() -> None:
    assert quantile_skewness(quantiles_of(scipy.stats.norm())) == pytest.approx([0.0], abs=1e-9)
    assert quantile_skewness(np.full((7, 2), 1.3)) == pytest.approx([0.0, 0.0])


def test_rank_correlation_is_scipys_with_ties_and_gaps() -> None:
    random = np.random.default_rng(2)
    first = random.normal(size=(400, 3))
    second = np.round(-first + random.normal(size=(400, 3)))
    first[random.random(first.shape) < 0.3] = np.nan
    second[np.isnan(first)] = np.nan
    second[5] = np.nan
    expected = [
        scipy.stats.spearmanr(one, two, nan_policy="omit").statistic
        for one, two in zip(first.T, second.T, strict=True)
    ]
    np.testing.assert_allclose(rank_correlation(first, second), expected, rtol=1e-12)


def test_rank_correlation_of_monotonous_values_is_one_and_of_a_constant_unknown() -> None:
    rising = np.linspace(0, 3, 20)[:, None]
    columns = np.hstack([np.exp(rising), -(rising**3), np.full_like(rising, 2.0)])
    np.testing.assert_allclose(rank_correlation(np.repeat(rising, 3, axis=1), columns), [1.0, -1.0, np.nan])


def test_what_was_not_heard_does_not_count() -> None:
    random = np.random.default_rng(3)
    errors, rss = random.normal(size=(60, 2)), random.normal(size=(60, 2))
    expected = random.normal(size=(60, 2))
    errors[40:, 1] = rss[40:, 1] = expected[40:, 1] = np.nan
    both = match_statistics(errors, expected, rss)
    alone = match_statistics(errors[:40, 1:], expected[:40, 1:], rss[:40, 1:])
    assert both.n.tolist() == [60, 40]
    for name, values in vars(alone).items():
        assert getattr(both, name)[1:] == pytest.approx(values), name


def test_the_mean_alone_has_no_spread_around_itself() -> None:
    expected = np.random.default_rng(4).normal(size=(50, 1))
    made = match_statistics(expected, expected, -60.0 - expected)
    assert made.spread_m[0] > 0.5
    assert (made.local_spread_m[0], made.local_skewness[0]) == (0.0, 0.0)
    assert made.dependence == pytest.approx([-1.0])
    assert made.bias_m == pytest.approx(np.median(expected, axis=0))
