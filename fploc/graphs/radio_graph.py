"""An interval as a graph: access points and devices are nodes, measured ranges are edges towards devices."""

from __future__ import annotations

import torch
from torch import Tensor
from torch_geometric.data import Data

from fploc.intervals import Intervals

EDGE_FEATURES = ("range_m", "rss_dbm", "is_device_link")
BETWEEN_DEVICES = -1


def radio_graph(intervals: Intervals, access_points: Tensor, first_estimates: Tensor) -> Data:
    """Return the graph of one interval of B devices among A access points.

    Paper: Yu et al., section "Graph Representation". The first B nodes are the devices, the next A the
    access points. An edge runs from every access point to each device that heard it, and between devices
    from the sender to the receiver of each link in ``intervals.links``. Changed: the index n of the
    neighbour is no edge feature (the graph must not depend on the order of access points); it stands
    apart, for the network that asks for it.

    Args:
        intervals: One interval of each device.
        access_points: Shape (A, 2), metres, site frame.
        first_estimates: First estimate of each device, shape (B, 2), metres, site frame.

    Returns:
        ``pos`` (B + A, 2) metres, site frame; ``devices`` = B; ``edge_index`` (2, E), neighbour to device;
        ``edge_attr`` (E, 3) as in ``EDGE_FEATURES``; ``access_point`` (E,) int64, n of each edge's access
        point in the order of ``access_points``, −1 between devices.
    """
    devices = len(first_estimates)
    device, access_point = torch.nonzero(intervals.heard, as_tuple=True)
    heard = (device, access_point)
    sources, targets = access_point + devices, device
    attributes = torch.stack(
        [
            intervals.ranges[heard],
            intervals.rss[heard],
            torch.zeros_like(intervals.ranges[heard]),
        ],
        dim=-1,
    )
    if intervals.links is not None:
        receiver, sender = intervals.links.index
        sources, targets = torch.cat([sources, sender]), torch.cat([targets, receiver])
        ranges = intervals.links.ranges
        between = torch.stack([ranges, intervals.links.rss, torch.ones_like(ranges)], dim=-1)
        attributes = torch.cat([attributes, between])
        access_point = torch.cat([access_point, torch.full_like(sender, BETWEEN_DEVICES)])
    return Data(
        pos=torch.cat([first_estimates, access_points]),
        devices=devices,
        edge_index=torch.stack([sources, targets]),
        edge_attr=attributes.to(first_estimates.dtype),
        access_point=access_point,
    )


def neighbours(intervals: Intervals) -> Tensor:
    """Return how many access points and devices each device has a range to, shape (B,), int64."""
    counts = intervals.heard.sum(-1)
    if intervals.links is None:
        return counts
    return counts.scatter_add(0, intervals.links.index[0], torch.ones_like(intervals.links.index[0]))
