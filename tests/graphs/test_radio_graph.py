from __future__ import annotations

import torch

from fploc.graphs.radio_graph import neighbours, radio_graph
from fploc.intervals import DeviceLinks, Intervals

ACCESS_POINTS = torch.tensor([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0]])
FIRST = torch.tensor([[1.0, 1.0], [5.0, 5.0]])


def intervals(links: DeviceLinks | None = None) -> Intervals:
    heard = torch.tensor([[True, False, True], [False, True, True]])
    return Intervals(
        t_s=torch.zeros(2, dtype=torch.float64),
        ranges=torch.tensor([[1.0, 0.0, 3.0], [0.0, 5.0, 6.0]]),
        stds=torch.zeros(2, 3),
        rss=torch.tensor([[-41.0, 0.0, -43.0], [0.0, -45.0, -46.0]]),
        heard=heard,
        present=torch.ones(2, dtype=torch.bool),
        links=links,
    )


def edges(links: DeviceLinks | None) -> set[tuple[float, ...]]:
    graph = radio_graph(intervals(links), ACCESS_POINTS, FIRST)
    return {
        (*nodes, *attributes)
        for nodes, attributes in zip(graph.edge_index.T.tolist(), graph.edge_attr.tolist(), strict=True)
    }


HEARD = {(2, 0, 1.0, -41.0, 0.0), (4, 0, 3.0, -43.0, 0.0), (3, 1, 5.0, -45.0, 0.0), (4, 1, 6.0, -46.0, 0.0)}


def test_edges_run_from_heard_access_points_to_devices() -> None:
    assert edges(None) == HEARD


def test_a_device_link_is_an_edge_from_sender_to_receiver() -> None:
    """``DeviceLinks.index`` is receiver, sender."""
    links = DeviceLinks(torch.tensor([[1], [0]]), torch.tensor([4.5]), torch.tensor([-51.0]))
    assert edges(links) == HEARD | {(0, 1, 4.5, -51.0, 1.0)}


def test_edges_know_the_index_of_their_access_point() -> None:
    links = DeviceLinks(torch.tensor([[1], [0]]), torch.tensor([4.5]), torch.tensor([-51.0]))
    graph = radio_graph(intervals(links), ACCESS_POINTS, FIRST)
    assert graph.access_point.dtype == torch.int64
    assert graph.access_point.tolist() == [0, 2, 1, 2, -1]
    torch.testing.assert_close(graph.pos[graph.edge_index[0, :4]], ACCESS_POINTS[graph.access_point[:4]])


def test_no_device_link_is_the_same_as_none() -> None:
    links = DeviceLinks(torch.zeros(2, 0, dtype=torch.int64), torch.zeros(0), torch.zeros(0))
    assert edges(links) == HEARD


def test_nodes_are_devices_then_access_points() -> None:
    graph = radio_graph(intervals(), ACCESS_POINTS, FIRST)
    assert graph.devices == 2
    assert torch.equal(graph.pos, torch.cat([FIRST, ACCESS_POINTS]))
    assert graph.edge_attr.dtype == FIRST.dtype


def test_neighbours_are_access_points_and_received_devices() -> None:
    assert neighbours(intervals()).tolist() == [2, 2]
    links = DeviceLinks(torch.tensor([[1, 1], [0, 0]]), torch.ones(2), torch.ones(2))
    assert neighbours(intervals(links)).tolist() == [2, 4]
