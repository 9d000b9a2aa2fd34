from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.graphs.first_estimates import first_estimates
from fploc.graphs.radio_graph import radio_graph
from fploc.intervals import DeviceLinks, Intervals, NoFix
from fploc.methods.gnn import GNNMethod, reasons_for_neighbours
from fploc.models.gnn import GNN, LARGEST_RESIDUAL_M, unit_vectors
from fploc.sites.site import AccessPoint, Site

A, B = 6, 4


def network(layers: int = 3, index_width: int = 0) -> GNN:
    """Random weights in double precision, the last layer included: an untrained GNN moves nothing."""
    torch.manual_seed(0)
    made = GNN(hidden=16, message_width=5, layers=layers, index_width=index_width).double().eval()
    torch.nn.init.normal_(made.update_ffnn[-1].weight, std=0.3)
    torch.nn.init.normal_(made.update_ffnn[-1].bias, std=0.1)
    return made


def scene(seed: int, devices: int = B, noise_m: float = 1.0) -> tuple[Intervals, Tensor, Tensor]:
    """Intervals of ``devices`` devices in a hall of 20 m × 20 m with access points on a ring around it.

    Returns intervals, access points and true positions, in double precision.
    """
    random = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, dtype=torch.float64)

    angles = 2 * torch.pi * (torch.arange(A, dtype=torch.float64) + 0.5 * uniform(A)) / A
    access_points = 10 + 12 * torch.stack([angles.cos(), angles.sin()], dim=-1)
    truth = 20 * uniform(devices, 2)
    distances = (truth[:, None] - access_points).norm(dim=-1)
    heard = uniform(devices, A) < 0.8
    ranges = (distances - noise_m * torch.log(uniform(devices, A))) * heard
    index = torch.tensor([[0, 1, 2], [1, 0, 3]])
    between = (truth[index[0]] - truth[index[1]]).norm(dim=-1) + noise_m * uniform(3)
    intervals = Intervals(
        t_s=torch.zeros(devices, dtype=torch.float64),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=(-40.0 - 20 * torch.log10(distances.clamp(min=1)) - 10 * uniform(devices, A)) * heard,
        heard=heard,
        present=torch.ones(devices, dtype=torch.bool),
        links=DeviceLinks(index=index, ranges=between, rss=-50 - 10 * uniform(3)),
    )
    return intervals, access_points, truth


def located(gnn: GNN, intervals: Intervals, access_points: Tensor) -> Tensor:
    with torch.no_grad():
        return gnn(radio_graph(intervals, access_points, first_estimates(intervals, access_points)))


def columns_of(intervals: Intervals, order: Tensor) -> Intervals:
    return Intervals(
        t_s=intervals.t_s,
        ranges=intervals.ranges[:, order],
        stds=intervals.stds[:, order],
        rss=intervals.rss[:, order],
        heard=intervals.heard[:, order],
        present=intervals.present,
        links=intervals.links,
    )


def rows_of(intervals: Intervals, order: Tensor) -> Intervals:
    assert intervals.links is not None
    place = torch.argsort(order)
    links = DeviceLinks(
        index=place[intervals.links.index], ranges=intervals.links.ranges, rss=intervals.links.rss
    )
    return Intervals(
        t_s=intervals.t_s[order],
        ranges=intervals.ranges[order],
        stds=intervals.stds[order],
        rss=intervals.rss[order],
        heard=intervals.heard[order],
        present=intervals.present[order],
        links=links,
    )


SEEDS = st.integers(0, 10_000)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.permutations(range(A)))
def test_order_of_access_points_changes_nothing(seed: int, order: list[int]) -> None:
    intervals, access_points, _ = scene(seed)
    turned = torch.tensor(order)
    gnn = network()
    torch.testing.assert_close(
        located(gnn, columns_of(intervals, turned), access_points[turned]),
        located(gnn, intervals, access_points),
    )


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.permutations(range(B)))
def test_devices_keep_their_positions_in_any_order(seed: int, order: list[int]) -> None:
    intervals, access_points, _ = scene(seed)
    turned = torch.tensor(order)
    gnn = network()
    torch.testing.assert_close(
        located(gnn, rows_of(intervals, turned), access_points),
        located(gnn, intervals, access_points)[turned],
    )


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(-200, 200), st.floats(-200, 200))
def test_positions_move_with_the_frame(seed: int, x_m: float, y_m: float) -> None:
    intervals, access_points, _ = scene(seed)
    shift = torch.tensor([x_m, y_m], dtype=torch.float64)
    gnn = network()
    torch.testing.assert_close(
        located(gnn, intervals, access_points + shift),
        located(gnn, intervals, access_points) + shift,
        rtol=0.0,
        atol=1e-6,
    )


def test_with_the_index_the_order_of_access_points_matters() -> None:
    """The published feature n: what the default leaves out."""
    intervals, access_points, _ = scene(2)
    turned = torch.tensor([1, 2, 3, 4, 5, 0])
    gnn = network(index_width=A)
    listed_otherwise = located(gnn, columns_of(intervals, turned), access_points[turned])
    assert (listed_otherwise - located(gnn, intervals, access_points)).abs().max() > 0.1


def test_indices_are_one_hot_and_none_beyond_their_places() -> None:
    indices = network(index_width=3).indices(torch.tensor([2, 0, 5, -1]))
    assert indices.tolist() == [[0, 0, 1], [1, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert network().indices(torch.tensor([2, 0])).shape == (2, 0)


def test_a_device_link_tells_the_receiver_of_the_sender() -> None:
    """Device 2 receives from device 3, not the reverse: only device 2 may change with that link."""
    intervals, access_points, _ = scene(3)
    gnn = network(layers=1)
    before = located(gnn, intervals, access_points)
    assert intervals.links is not None
    intervals.links.ranges[2] += 4.0
    moved = (located(gnn, intervals, access_points) - before).abs().sum(-1) > 1e-9
    assert moved.tolist() == [False, False, True, False]


def test_a_device_is_told_from_an_access_point_at_the_same_place() -> None:
    random = torch.Generator().manual_seed(0)
    attributes = torch.tensor([[5.0, -60.0, 0.0], [5.0, -60.0, 1.0]], dtype=torch.float64)
    inputs = GNN.edge_inputs(attributes)
    assert torch.equal(inputs[0, :3], inputs[1, :3]) and inputs[:, 3].tolist() == [0.0, 1.0]
    positions = torch.rand(1, 2, generator=random, dtype=torch.float64).expand(2, 2)
    other = positions + 3.0
    residuals = torch.zeros(2, dtype=torch.float64)
    messages = network().message(positions, other, residuals, inputs)
    assert not torch.allclose(messages[0], messages[1])


def test_untrained_network_returns_the_first_estimates_which_noise_free_ranges_make_true() -> None:
    intervals, access_points, truth = scene(7, devices=60, noise_m=0.0)
    gnn = GNN(hidden=8, message_width=2, layers=3).double()
    first = first_estimates(intervals, access_points)
    positions = located(gnn, intervals, access_points)
    torch.testing.assert_close(positions, first, rtol=0.0, atol=0.0)
    fixed = intervals.heard.sum(-1) >= 3
    assert fixed.sum() > 40
    torch.testing.assert_close(positions[fixed], truth[fixed], rtol=0.0, atol=1e-6)


def test_residuals_are_signed_and_limited() -> None:
    nodes = torch.tensor([[0.0, 0.0], [3.0, 4.0], [300.0, 0.0]])
    edges = torch.tensor([[1, 1, 2, 1], [0, 0, 0, 0]])
    residuals = GNN.residuals(nodes, edges, torch.tensor([5.0, 7.0, 1.0, 99.0]))
    assert residuals.tolist() == [0.0, -2.0, LARGEST_RESIDUAL_M, -LARGEST_RESIDUAL_M]


def test_device_features_are_counts_means_and_displacements() -> None:
    residuals, targets = torch.tensor([1.0, 3.0, -2.0]), torch.tensor([0, 0, 1])
    displacements = torch.tensor([[1.0, -2.0], [0.0, 0.0], [5.0, 0.0]])
    features = GNN.device_features(residuals, targets, displacements)
    expected = [
        [2 / 8, 0.2, 5**0.5 / 10, 0.1, -0.2],
        [1 / 8, -0.2, 0.2, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.5, 0.0],
    ]
    torch.testing.assert_close(features, torch.tensor(expected), rtol=0.0, atol=1e-3)


def test_direction_between_equal_places_is_zero() -> None:
    offsets = torch.tensor([[3.0, 4.0], [0.0, 0.0]])
    vectors = unit_vectors(offsets, offsets.norm(dim=-1))
    torch.testing.assert_close(vectors, torch.tensor([[0.6, 0.8], [0.0, 0.0]]))


def test_gradient_is_finite_where_a_device_stands_on_its_neighbour() -> None:
    """A first estimate can coincide with an access point: the derivative of a norm at 0 must not be NaN."""
    access_points = torch.tensor([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    intervals = Intervals(
        t_s=torch.zeros(1, dtype=torch.float64),
        ranges=torch.tensor([[0.0, 10.0, 10.0]]),
        stds=torch.zeros(1, 3),
        rss=torch.full((1, 3), -50.0),
        heard=torch.ones(1, 3, dtype=torch.bool),
        present=torch.ones(1, dtype=torch.bool),
    )
    gnn = GNN(hidden=8, message_width=4, layers=2)
    torch.nn.init.normal_(gnn.update_ffnn[-1].weight)
    gnn(radio_graph(intervals, access_points, access_points[:1].clone())).square().sum().backward()
    assert all(torch.isfinite(parameter.grad).all() for parameter in gnn.parameters())


def test_a_little_training_lowers_the_error_on_new_scenes() -> None:
    torch.manual_seed(0)
    gnn = GNN(hidden=32, message_width=16, layers=2).double()
    optimizer = torch.optim.Adam(gnn.parameters(), lr=5e-3)

    def rmse_m(positions: Tensor, truth: Tensor) -> float:
        return float((positions - truth).square().sum(-1).mean().sqrt())

    for step in range(150):
        intervals, access_points, truth = scene(step, devices=48, noise_m=1.5)
        first = first_estimates(intervals, access_points)
        loss = (gnn(radio_graph(intervals, access_points, first)) - truth).square().sum(-1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    held_out = [scene(1000 + seed, devices=48, noise_m=1.5) for seed in range(10)]
    before = np.mean([rmse_m(first_estimates(one, points), truth) for one, points, truth in held_out])
    after = np.mean([rmse_m(located(gnn, one, points), truth) for one, points, truth in held_out])
    assert after < 0.85 * before


def test_preset_paper_has_the_published_widths() -> None:
    gnn = instantiate(GNN, read_conf("model", "gnn-paper"))
    widths = [
        [(layer.in_features, layer.out_features) for layer in ffnn if isinstance(layer, torch.nn.Linear)]
        for ffnn in (gnn.message_ffnn, gnn.update_ffnn)
    ]
    assert widths == [[(9, 8), (8, 2)], [(7, 8), (8, 2)]]
    assert sum(parameter.numel() for parameter in gnn.parameters()) == 180


def test_weights_are_shared_over_layers() -> None:
    sizes = {sum(p.numel() for p in GNN(hidden=8, message_width=2, layers=n).parameters()) for n in (1, 4)}
    assert len(sizes) == 1


def test_method_fixes_devices_with_three_neighbours() -> None:
    points = tuple(AccessPoint(f"AP{i}", f"m{i}", 9.0 * (i % 2), 4.5 * i, 2.0) for i in range(4))
    site = Site("hall", "hall", points, device_height_m=1.0)
    heard = torch.tensor([[True] * 4, [True, True, True, False], [True, False, True, False], [False] * 4])
    truth = torch.tensor([[3.0, 4.0], [5.0, 2.0], [6.0, 6.0], [1.0, 1.0]])
    ranges = (truth[:, None] - torch.tensor(site.positions_m).float()).norm(dim=-1) * heard
    intervals = Intervals(
        t_s=torch.zeros(4, dtype=torch.float64),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=-60.0 * heard,
        heard=heard,
        present=torch.tensor([True, True, True, True]),
    )
    method = GNNMethod(GNN(hidden=8, message_width=2, layers=1).eval(), variance_m2=2.5)
    _, found = method.step(method.init(site, 4), intervals)
    assert found.reasons.tolist() == [NoFix.FIXED, NoFix.FIXED, NoFix.TOO_FEW_RANGES, NoFix.NO_READING]
    torch.testing.assert_close(found.positions[:2], truth[:2].double(), rtol=0.0, atol=1e-3)
    torch.testing.assert_close(found.covariances[0], 2.5 * torch.eye(2, dtype=torch.float64))
    assert found.positions[2:].isnan().all()


@pytest.mark.parametrize(("links", "reason"), [(0, NoFix.TOO_FEW_RANGES), (1, NoFix.FIXED)])
def test_a_device_link_counts_as_a_neighbour(links: int, reason: NoFix) -> None:
    intervals, _, _ = scene(0, devices=4)
    heard = torch.zeros(4, A, dtype=torch.bool)
    heard[0, :2] = True
    some = Intervals(
        t_s=intervals.t_s,
        ranges=intervals.ranges,
        stds=intervals.stds,
        rss=intervals.rss,
        heard=heard,
        present=torch.tensor([True, True, True, False]),
        links=DeviceLinks(
            index=torch.tensor([[0], [1]])[:, :links], ranges=torch.ones(links), rss=-torch.ones(links)
        ),
    )
    assert reasons_for_neighbours(some).tolist() == [reason] + [NoFix.NO_READING] * 3


def test_a_range_beyond_60_m_counts_as_not_heard() -> None:
    random = torch.Generator().manual_seed(3)
    near = torch.rand(1, 5, generator=random) * 20 + 1
    heard = torch.ones(1, 5, dtype=torch.bool)
    whole = Intervals(
        t_s=torch.zeros(1),
        ranges=torch.cat([near, torch.tensor([[75.0]])], dim=1),
        stds=torch.zeros(1, 6),
        rss=torch.full((1, 6), -60.0),
        heard=torch.ones(1, 6, dtype=torch.bool),
        present=torch.tensor([True]),
    )
    kept = whole.nearer_than(60.0)
    assert torch.equal(kept.heard[:, :5], heard) and not kept.heard[0, 5]
    assert torch.equal(kept.ranges[:, :5], near) and kept.ranges[0, 5] == 0 and kept.rss[0, 5] == 0
