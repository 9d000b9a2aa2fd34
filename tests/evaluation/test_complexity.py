from __future__ import annotations

import json

import torch

from fploc.conf import read_conf
from fploc.evaluation.complexity import ACCESS_POINTS, complexity, complexity_rows
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, DistanceHead
from fploc.models.gnn import DEVICE_FEATURES, EDGE_INPUTS, GNN, NODE_FEATURES


def fpdnn(dim: int) -> FPDNN:
    vision = DeepViT(
        crop_height_px=8, max_length_px=80, patch_px=(8, 4), dim=dim, depth=1, num_heads=2, head_dim=4
    )
    return FPDNN(vision, DistanceHead(64))


def test_the_gnns_operations_are_two_for_each_weight_that_an_edge_or_a_node_meets() -> None:
    hidden, message, layers = 8, 2, 3
    found = complexity(GNN(hidden=hidden, message_width=message, layers=layers))
    per_edge = (NODE_FEATURES + EDGE_INPUTS) * hidden + hidden * message
    per_device = (DEVICE_FEATURES + message) * hidden + hidden * 2
    assert found.flops == 2 * layers * (ACCESS_POINTS * per_edge + per_device)
    biases = hidden + message + hidden + 2
    assert found.parameters == per_edge + per_device + biases
    assert found.ms > 0


def test_parameters_are_those_that_are_trained() -> None:
    network = fpdnn(16)
    whole = complexity(network).parameters
    assert whole == sum(one.numel() for one in network.parameters())
    network.nothing.requires_grad_(False)
    assert complexity(network).parameters == whole - network.nothing.numel()


def test_a_wider_network_costs_more_and_threads_are_left_as_they_were() -> None:
    threads = torch.get_num_threads()
    narrow, wide = complexity(fpdnn(8)), complexity(fpdnn(32))
    assert narrow.flops < wide.flops and narrow.parameters < wide.parameters
    assert torch.get_num_threads() == threads


def test_rows_hold_the_papers_counts_where_it_gives_any() -> None:
    names = ("gnn-paper", "fpdnn", "generator")
    gnn, small, generator = complexity_rows({name: read_conf("model", name) for name in names})
    assert [row["network"] for row in (gnn, small, generator)] == list(names)
    assert (gnn["paper_parameters"], gnn["paper_flops"]) == (1381, 2704)
    assert (small["paper_parameters"], small["paper_flops"]) == (863_097, 23_522_913)
    assert generator["paper_parameters"] is None and generator["flops"] > 0
    json.dumps([gnn, small, generator])


def test_published_widths_take_the_operations_of_a_graph_with_eight_edges() -> None:
    (row,) = complexity_rows({"gnn-paper": read_conf("model", "gnn-paper")})
    edges, update = 2 * 8 * (9 * 8 + 8 * 2), 2 * (7 * 8 + 8 * 2)
    assert row["flops"] == edges + update
    # The paper's count updates the access points as well: nine nodes instead of one.
    assert row["paper_flops"] == edges + 9 * update
