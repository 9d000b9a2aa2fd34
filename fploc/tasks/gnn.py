"""Training of the GNN on intervals, turned at random."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.graphs.first_estimates import first_estimates
from fploc.graphs.radio_graph import radio_graph
from fploc.models.gnn import GNN
from fploc.tasks.streams import StreamTask


def random_turn(device: torch.device) -> Tensor:
    """Return a random rotation, mirrored or not, shape (2, 2)."""
    angle = float(torch.rand(())) * 2 * math.pi
    mirror = 1.0 if float(torch.rand(())) < 0.5 else -1.0
    return torch.tensor(
        [
            [math.cos(angle), -mirror * math.sin(angle)],
            [math.sin(angle), mirror * math.cos(angle)],
        ],
        device=device,
    )


class GNNTask(StreamTask):
    """Mean squared distance to the truth (paper, eq. "LossGNN").

    In training every batch is turned and mirrored at random, since the network sees directions and the
    source has only those of its own corridors.

    Args:
        network: The GNN.
        learning_rate: Adam's; published 2e-4.
        weight_decay: Adam's.
    """

    name = "gnn"
    network: GNN

    def __init__(self, network: GNN, learning_rate: float = 2e-4, weight_decay: float = 1e-5) -> None:
        super().__init__(network, learning_rate, weight_decay)

    def on_validation_epoch_end(self) -> None:
        """Log the root mean squared error over all validation intervals."""
        self.log("val/rmse_m", self.trainer.callback_metrics["val/loss"].sqrt(), sync_dist=True)

    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        turn = random_turn(self.device) if stage == "train" else torch.eye(2, device=self.device)
        access_points = batch.access_points @ turn.T
        first = first_estimates(batch.intervals, access_points)
        coarse = self.network(radio_graph(batch.intervals, access_points, first))
        loss = (coarse - batch.positions @ turn.T).square().sum(-1).mean()
        self.log_mean(f"{stage}/loss", loss, len(coarse))
        return loss
