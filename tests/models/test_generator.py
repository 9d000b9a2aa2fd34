from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
import torch

from fploc.models.deepvit import DeepViT
from fploc.models.generator import SMALLEST_SPREAD, Generator, MeasurementDistribution

SHAPES = [(0.0, 1.0, 1.0), (-0.7, 0.3, 2.5), (1.2, 1.5, 0.1), (0.4, 0.05, 4.0), (0.0, 2.0, 0.02)]


def distribution(shift: float, spread: float, tail: float, number: int = 1) -> MeasurementDistribution:
    """Double precision; the same link ``number`` times."""

    def column(value: float) -> torch.Tensor:
        return torch.full((number,), value, dtype=torch.float64)

    return MeasurementDistribution(
        shift=column(shift),
        spread=column(spread),
        tail=column(tail),
        rss_mean=column(-62.0),
        rss_slope=column(-1.5),
        rss_spread=column(3.0),
    )


def generator() -> Generator:
    torch.manual_seed(0)
    vision = DeepViT(
        crop_height_px=8, max_length_px=40, patch_px=(8, 4), dim=8, depth=1, num_heads=2, head_dim=4
    )
    return Generator(vision).eval()


@pytest.mark.parametrize(("shift", "spread", "tail"), SHAPES)
def test_density_of_the_error_is_the_exponentially_modified_gaussian(
    shift: float, spread: float, tail: float
) -> None:
    errors = np.linspace(shift - 8 * spread, shift + 8 * spread + 12 * tail, 400)
    ours = distribution(shift, spread, tail, len(errors)).log_prob_error(torch.from_numpy(errors))
    expected = scipy.stats.exponnorm.logpdf(errors, K=tail / spread, loc=shift, scale=spread)
    np.testing.assert_allclose(ours.numpy(), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("shift", "spread", "tail"), SHAPES)
def test_density_of_the_error_integrates_to_one(shift: float, spread: float, tail: float) -> None:
    errors = torch.linspace(shift - 10 * spread, shift + 10 * spread + 30 * tail, 40_001, dtype=torch.float64)
    density = distribution(shift, spread, tail, len(errors)).log_prob_error(errors).exp()
    assert float(torch.trapezoid(density, errors)) == pytest.approx(1.0, abs=1e-4)


def test_density_and_gradient_stay_finite_in_single_precision() -> None:
    spread = torch.tensor([SMALLEST_SPREAD, SMALLEST_SPREAD, 5.0, 1.0], requires_grad=True)
    tail = torch.tensor([SMALLEST_SPREAD, 10.0, SMALLEST_SPREAD, 1.0], requires_grad=True)
    shift = torch.zeros(4, requires_grad=True)
    zeros = torch.zeros(4)
    made = MeasurementDistribution(shift, spread, tail, zeros, zeros, zeros + 1.0)
    for error in (-30.0, -1.0, 0.0, 1.0, 60.0):
        log_prob = made.log_prob_error(torch.full((4,), error))
        assert torch.isfinite(log_prob).all(), error
        gradients = torch.autograd.grad(log_prob.sum(), (shift, spread, tail))
        assert all(torch.isfinite(gradient).all() for gradient in gradients), error


def test_signal_strength_is_normal_given_the_error() -> None:
    rss, errors = torch.tensor([-70.0, -60.0]).double(), torch.tensor([0.0, 2.0]).double()
    ours = distribution(0.0, 1.0, 1.0, 2).log_prob_rss(rss, errors)
    expected = scipy.stats.norm.logpdf([-70.0, -60.0], loc=[-62.0, -65.0], scale=3.0)
    np.testing.assert_allclose(ours.numpy(), expected, rtol=1e-12)


@pytest.mark.parametrize(("shift", "spread", "tail"), SHAPES[:4])
def test_samples_have_the_moments_of_the_distribution(shift: float, spread: float, tail: float) -> None:
    made = distribution(shift, spread, tail, 200_000)
    errors, rss = (drawn.numpy() for drawn in made.sample(torch.Generator().manual_seed(0)))
    K = tail / spread
    mean, variance, skew = scipy.stats.exponnorm.stats(K, loc=shift, scale=spread, moments="mvs")
    assert errors.mean() == pytest.approx(mean, abs=0.02)
    assert errors.std() == pytest.approx(np.sqrt(variance), rel=0.01)
    assert scipy.stats.skew(errors) == pytest.approx(skew, abs=0.1)
    assert errors.mean() == pytest.approx(float(made.mean_error()[0]), abs=0.02)
    assert rss.mean() == pytest.approx(float(made.mean_rss()[0]), abs=0.05)
    # A longer path is a weaker one: cov(e, γ) = slope · var(e).
    assert np.cov(errors, rss)[0, 1] == pytest.approx(-1.5 * variance, rel=0.05, abs=0.03)


def test_sampling_is_the_generators_alone() -> None:
    made = distribution(0.0, 1.0, 1.0, 50)
    torch.manual_seed(1)
    first = made.sample(torch.Generator().manual_seed(3))
    torch.manual_seed(2)
    untouched = torch.get_rng_state()
    again = made.sample(torch.Generator().manual_seed(3))
    other = made.sample(torch.Generator().manual_seed(4))
    assert all(torch.equal(one, two) for one, two in zip(first, again, strict=True))
    assert not torch.equal(first[0], other[0])
    assert torch.equal(torch.get_rng_state(), untouched)


@torch.no_grad()
def test_network_gives_a_proper_distribution_for_any_length() -> None:
    distances = torch.tensor([0.0, 0.01, 5.0, 40.0, 500.0])
    images, lengths_px = torch.rand(5, 1, 8, 40), torch.tensor([1, 1, 10, 40, 40])
    made = generator()(images, lengths_px, distances)
    for name in ("shift", "spread", "tail", "rss_mean", "rss_slope", "rss_spread"):
        value = getattr(made, name)
        assert value.shape == (5,) and torch.isfinite(value).all(), name
    for value in (made.spread, made.tail, made.rss_spread):
        assert value.min() >= SMALLEST_SPREAD
    assert torch.isfinite(made.log_prob_error(torch.zeros(5))).all()


@torch.no_grad()
def test_order_of_links_does_not_matter() -> None:
    network = generator()
    images, lengths_px, distances = torch.rand(6, 1, 8, 20), torch.arange(1, 7) * 3, torch.arange(1.0, 7.0)
    turned = torch.tensor([3, 0, 5, 1, 4, 2])
    ours = network(images, lengths_px, distances)
    theirs = network(images[turned], lengths_px[turned], distances[turned])
    torch.testing.assert_close(theirs.tail, ours.tail[turned])
    torch.testing.assert_close(theirs.rss_mean, ours.rss_mean[turned])


def test_a_few_steps_learn_bias_and_signal_strength() -> None:
    """Likelihood on links of one true distribution: its mean error and mean RSS come out."""
    torch.manual_seed(0)
    network = generator()
    truth = distribution(0.3, 0.4, 0.8, 256)
    errors, rss = (drawn.float() for drawn in truth.sample(torch.Generator().manual_seed(5)))
    images, lengths_px = torch.zeros(256, 1, 8, 4), torch.full((256,), 4)
    distances = torch.full((256,), 8.0)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    for _ in range(80):
        made = network(images, lengths_px, distances)
        loss = -(made.log_prob_error(errors) + made.log_prob_rss(rss, errors)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        made = network(images[:1], lengths_px[:1], distances[:1])
    assert float(made.mean_error()) == pytest.approx(float(errors.mean()), abs=0.2)
    assert float(made.mean_rss()) == pytest.approx(float(rss.mean()), abs=1.0)
