from __future__ import annotations

import torch

from fploc.models.range_error import RangeErrorNetwork, log_density

ERRORS_M = torch.linspace(-400.0, 400.0, 80_001, dtype=torch.float64)


def test_the_explained_part_is_a_density_with_the_stated_sides() -> None:
    raw = torch.tensor([[0.7, 0.3, 2.0, -50.0]], dtype=torch.float64)
    density = log_density(raw, ERRORS_M[None]).exp()[0]
    floor = log_density(raw, torch.tensor([[-300.0, 300.0]], dtype=torch.float64)).exp()[0]
    at_mode = density.argmax()
    torch.testing.assert_close(ERRORS_M[at_mode], torch.tensor(0.7, dtype=torch.float64), atol=0.01, rtol=0)
    whole = torch.where(ERRORS_M > -3, density - 0.005 / 25, density - 0.005 / 250).sum() * 0.01
    torch.testing.assert_close(whole, torch.tensor(0.995, dtype=torch.float64), atol=1e-3, rtol=0)
    assert floor[1] > 5 * floor[0]
    assert density[at_mode + 100] > density[at_mode - 100]


def test_it_is_moved_by_its_mode() -> None:
    raw = torch.tensor([[0.0, 0.5, 1.0, -1.0], [1.5, 0.5, 1.0, -1.0]], dtype=torch.float64)
    errors = torch.tensor([[0.4], [1.9]], dtype=torch.float64)
    one, other = log_density(raw, errors)[:, 0]
    torch.testing.assert_close(one, other)


def test_features_far_outside_what_was_learned_count_as_its_edge() -> None:
    torch.manual_seed(0)
    network = RangeErrorNetwork((0, 1, 2), 2, hidden=8, dropout=0.5).eval()
    assert torch.equal(network(torch.full((1, 3), 1e6).double()), network(torch.full((1, 3), 3.0).double()))
    assert torch.isfinite(network(torch.zeros(2, 3).double())).all()


def test_features_out_of_view_change_nothing() -> None:
    torch.manual_seed(0)
    network = RangeErrorNetwork((0, 2), 2, hidden=8, dropout=0.5).eval()
    features = torch.tensor([[0.1, 0.2, 0.3], [0.1, -2.0, 0.3]], dtype=torch.float64)
    one, other = network(features)
    assert torch.equal(one, other)


def test_inputs_are_scaled_by_weighted_moments() -> None:
    network = RangeErrorNetwork((1, 2), 1, hidden=8, dropout=0.0)
    features = torch.tensor([[9.0, 1.0, 2.0], [9.0, 3.0, 2.0]], dtype=torch.float64)
    network.scale_by(features, torch.tensor([3.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close(network.means, torch.tensor([1.5, 2.0], dtype=torch.float64))
    torch.testing.assert_close(network.deviations, torch.tensor([0.75**0.5, 1e-2], dtype=torch.float64))


def test_sights_have_a_density_each_and_one_mixture_where_nobody_knows() -> None:
    torch.manual_seed(0)
    network = RangeErrorNetwork((0,), 2, hidden=8, dropout=0.0).eval()
    network.expect(torch.tensor([0, 1, 1]), torch.tensor([1.0, 1.0, 2.0], dtype=torch.float64))
    errors_m = torch.linspace(-5.0, 9.0, 50, dtype=torch.float64)
    found = log_density(network(torch.zeros(1, 1).double()), errors_m)
    assert found.shape == (1, 2, 50) and not torch.allclose(found[:, 0], found[:, 1])
    mixed = 0.25 * found[0, 0].exp() + 0.75 * found[0, 1].exp()
    torch.testing.assert_close(network.wherever(found)[0, 0].exp(), mixed)


def test_to_a_network_that_is_not_told_all_sights_are_one() -> None:
    network = RangeErrorNetwork((0,), 1, hidden=8, dropout=0.0)
    sights = torch.tensor([0, 1, 1])
    assert network.told_apart(sights).tolist() == [0, 0, 0]
    network.expect(sights, torch.ones(3, dtype=torch.float64))
    assert network.shares.tolist() == [1.0]
