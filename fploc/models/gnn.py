"""GNN pre-localization: coarse positions of devices from ranges, signal strengths and access points."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch_geometric.data import Data
from torch_geometric.nn import MessagePassing
from torch_geometric.utils import scatter

from fploc.intervals import RSS_AT_1_M_DBM
from fploc.models.fpdnn import RANGE_SCALE_M, RSS_CENTRE_DBM, RSS_SCALE_DB, zero_linear

NODE_FEATURES = 5
EDGE_INPUTS = 4
DEVICE_FEATURES = 5
LARGEST_RESIDUAL_M = 20.0
EXPECTED_NEIGHBOURS = 8.0


def unit_vectors(offsets: Tensor, lengths: Tensor) -> Tensor:
    """Return ``offsets`` (E, 2) divided by their ``lengths`` (E,), zero where the length is zero."""
    return offsets / lengths.clamp(min=1e-6)[:, None]


class GNN(MessagePassing):
    r"""Message passing from neighbours to devices, mean aggregation, update; weights shared over layers.

    Paper: Yu et al., section "Graph Neural Network", Table II:
    :math:`m_{mn} = \phi(h_n, e_{mn})`, :math:`\beta_m = \mathrm{mean}_n\, m_{mn}`,
    :math:`h_m \leftarrow \varphi(h_m, \beta_m)`; the output after L_g layers is the coarse position.
    Widths 9 → 8 → 2 and 7 → 8 → 2 are the published ones; they fit a node feature of five and an edge feature
    of four, and the paper does not say what all of these are. Its parameters carry no layer index, so layers
    share weights.
    Changed, so that the network carries to an unseen site: positions enter relative to the device (a neighbour
    is seen as the residual vector of its range, its distance, its residual and whether it is a device; an edge
    also as what its RSS falls short of free space), the device's own features are its number of neighbours,
    mean and RMS residual and its displacement so far, and the update adds to the position instead of replacing
    it, without the final ReLU that could give no negative coordinate. So the result moves with the frame and
    does not depend on the order of access points or devices.
    The published edge feature also holds the neighbour's index n. ``index_width`` brings it back for comparison:
    then a network can learn each access point's own faults, the result depends on the order in which access
    points are listed, and at another site, where the numbers stand for others, what was learned misleads.

    Args:
        hidden: Hidden width of φ and of the update.
        message_width: Width of a message.
        layers: L_g.
        index_width: Places of n as a one-hot feature of edges; indices beyond it and links between devices
            have none set. 0 leaves n out.

    Shapes:
        - **input:** a graph as made by ``fploc.graphs.radio_graph``
        - **output:** positions of its devices (M, 2), metres, site frame
    """

    def __init__(self, hidden: int, message_width: int, layers: int, index_width: int = 0) -> None:
        super().__init__(aggr="mean")
        self.layers = layers
        self.index_width = index_width
        self.message_ffnn = nn.Sequential(
            nn.Linear(NODE_FEATURES + EDGE_INPUTS + index_width, hidden),
            nn.ReLU(),
            nn.Linear(hidden, message_width),
        )
        self.update_ffnn = nn.Sequential(
            nn.Linear(DEVICE_FEATURES + message_width, hidden), nn.ReLU(), zero_linear(hidden, 2)
        )

    def forward(self, graph: Data) -> Tensor:
        """Return the coarse positions of the devices of ``graph``; see the class for shapes."""
        devices = int(graph.devices)
        first, access_points = graph.pos[:devices], graph.pos[devices:]
        indices = self.indices(graph.access_point).to(graph.edge_attr)
        edges = torch.cat([self.edge_inputs(graph.edge_attr), indices], dim=-1)
        positions = first
        for _ in range(self.layers):
            nodes = torch.cat([positions, access_points])
            residuals = self.residuals(nodes, graph.edge_index, graph.edge_attr[:, 0])
            aggregated = self.propagate(
                graph.edge_index,
                positions=nodes,
                residuals=residuals,
                edges=edges,
                size=(len(nodes), len(nodes)),
            )[:devices]
            own = self.device_features(residuals, graph.edge_index[1], positions - first)
            step = self.update_ffnn(torch.cat([own, aggregated], dim=-1))
            positions = positions + RANGE_SCALE_M * step
        return positions

    def message(self, positions_i: Tensor, positions_j: Tensor, residuals: Tensor, edges: Tensor) -> Tensor:
        """Return φ(h_n, e_mn) of every edge, shape (E, ``message_width``)."""
        offsets = positions_j - positions_i
        distances = offsets.norm(dim=-1)
        residual_vectors = residuals[:, None] * unit_vectors(offsets, distances)
        neighbour = torch.cat(
            [
                residual_vectors / RANGE_SCALE_M,
                torch.stack([distances, residuals], dim=-1) / RANGE_SCALE_M,
                edges[:, EDGE_INPUTS - 1 : EDGE_INPUTS],
            ],
            dim=-1,
        )
        messages: Tensor = self.message_ffnn(torch.cat([neighbour, edges], dim=-1))
        return messages

    def indices(self, access_point: Tensor) -> Tensor:
        """Return n of every edge as a one-hot feature, shape (E, ``index_width``), bool."""
        return access_point[:, None] == torch.arange(self.index_width, device=access_point.device)

    @staticmethod
    def residuals(nodes: Tensor, edge_index: Tensor, ranges: Tensor) -> Tensor:
        """Return |p_n − p_m| − ζ of every edge, limited to ± 20 m, shape (E,)."""
        sources, targets = edge_index
        residuals = (nodes[sources] - nodes[targets]).norm(dim=-1) - ranges
        return residuals.clamp(-LARGEST_RESIDUAL_M, LARGEST_RESIDUAL_M)

    @staticmethod
    def edge_inputs(edge_attr: Tensor) -> Tensor:
        """Return ζ, γ, their consistency with free space and device link of every edge, shape (E, 4)."""
        ranges, rss, device_link = edge_attr.unbind(-1)
        consistency = rss + 20.0 * torch.log10(ranges.clamp(min=1.0)) - RSS_AT_1_M_DBM
        return torch.stack(
            [
                ranges / RANGE_SCALE_M - 1.0,
                (rss - RSS_CENTRE_DBM) / RSS_SCALE_DB,
                consistency / RSS_SCALE_DB,
                device_link,
            ],
            dim=-1,
        )

    @staticmethod
    def device_features(residuals: Tensor, targets: Tensor, displacements: Tensor) -> Tensor:
        """Return neighbours, mean and RMS residual and displacement of each device, shape (M, 5)."""
        devices = len(displacements)
        ones = torch.ones_like(residuals)
        count = scatter(ones, targets, dim_size=devices, reduce="sum")
        mean = scatter(residuals, targets, dim_size=devices, reduce="mean")
        rms = scatter(residuals**2, targets, dim_size=devices, reduce="mean").add(1e-6).sqrt()
        return torch.cat(
            [
                torch.stack([count / EXPECTED_NEIGHBOURS, mean / RANGE_SCALE_M, rms / RANGE_SCALE_M], dim=-1),
                displacements / RANGE_SCALE_M,
            ],
            dim=-1,
        )
