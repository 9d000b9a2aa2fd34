"""What a network costs for one fix: parameters, FLOPs as torch counts them, milliseconds on one thread."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from fploc.conf import instantiate
from fploc.evaluation.paper_numbers import paper_numbers
from fploc.graphs.radio_graph import radio_graph
from fploc.intervals import Intervals
from fploc.models.fpdnn import FPDNN, Sight
from fploc.models.generator import Generator
from fploc.models.gnn import GNN

ACCESS_POINTS = 8
CROP_LENGTH_M = 10.0
RUNS = 50
"""The median of as many runs is reported."""

Call = Callable[[], object]


@dataclass(frozen=True)
class Complexity:
    """Cost of one fix: a device that hears eight access points, each 10 m away.

    Args:
        parameters: Numbers that are trained.
        flops: Floating point operations, two for each multiplication with addition, as
            ``torch.utils.flop_counter`` counts matrix products and nothing else.
        ms: Median of 50 runs on one thread, milliseconds, crops not included.
    """

    parameters: int
    flops: int
    ms: float


def complexity(network: nn.Module) -> Complexity:
    """Return what a GNN, an FPDNN or a generator costs for one fix on this machine."""
    network = network.eval()
    call = _call_of(network)
    with torch.inference_mode(), _one_thread():
        counter = FlopCounterMode(display=False)
        with counter:
            call()
        times = [_milliseconds(call) for _ in range(RUNS)]
    return Complexity(
        parameters=sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad),
        flops=counter.get_total_flops(),
        ms=statistics.median(times),
    )


def complexity_rows(specs: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each network, plain JSON values, the paper's counts beside where it gives any.

    Args:
        specs: ``class_path`` and ``init_args`` by a name, for example ``fpdnn-paper`` out of conf/model/. The
            paper's counts stand beside names that begin with ``gnn`` or ``fpdnn``.
    """
    paper = {
        (row.method, row.metric): row.value
        for row in paper_numbers()
        if row.metric in ("parameters", "flops")
    }
    rows = []
    for name, spec in specs.items():
        cost = complexity(instantiate(nn.Module, dict(spec)))
        kind = name.partition("-")[0]
        rows.append(
            {
                "network": name,
                "parameters": cost.parameters,
                "flops": cost.flops,
                "ms": cost.ms,
                "paper_parameters": _number(paper.get((kind, "parameters"))),
                "paper_flops": _number(paper.get((kind, "flops"))),
            }
        )
    return rows


def _call_of(network: nn.Module) -> Call:
    """Return what runs a network once on the links of one fix."""
    if isinstance(network, GNN):
        graph = radio_graph(_interval(), _access_points(), torch.zeros(1, 2))
        return lambda: network(graph)
    assert isinstance(network, FPDNN | Generator), "no other network runs for a fix"
    crops = network.vision.crops
    patches = -(-round(CROP_LENGTH_M * crops.pixels_per_metre) // crops.patch_length_px)
    width = patches * crops.patch_length_px
    images = torch.zeros(ACCESS_POINTS, 1, network.vision.crop_height_px, width)
    lengths_px = torch.full((ACCESS_POINTS,), width)
    ranges, rss = torch.full((ACCESS_POINTS,), CROP_LENGTH_M), torch.full((ACCESS_POINTS,), -60.0)
    if isinstance(network, Generator):
        return lambda: network(images, lengths_px, ranges)
    sight = torch.full((ACCESS_POINTS,), Sight.PLAN)
    return lambda: network(images, lengths_px, ranges, rss, sight)


def _access_points() -> Tensor:
    """Return access points on a circle around the device, shape (8, 2), metres."""
    angles = torch.arange(ACCESS_POINTS) * (2 * torch.pi / ACCESS_POINTS)
    return CROP_LENGTH_M * torch.stack([angles.cos(), angles.sin()], dim=-1)


def _interval() -> Intervals:
    links = (1, ACCESS_POINTS)
    return Intervals(
        t_s=torch.zeros(1),
        ranges=torch.full(links, CROP_LENGTH_M),
        stds=torch.zeros(links),
        rss=torch.full(links, -60.0),
        heard=torch.ones(links, dtype=torch.bool),
        present=torch.ones(1, dtype=torch.bool),
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _milliseconds(call: Call) -> float:
    started = time.perf_counter()
    call()
    return 1000.0 * (time.perf_counter() - started)


def _number(text: str | None) -> int | None:
    return None if text is None else int(text)
