"""Training of the GNN on intervals, turned at random."""

from __future__ import annotations

import math

import lightning.pytorch as pl
import torch
from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.graphs.first_estimates import first_estimates
from fploc.graphs.radio_graph import radio_graph
from fploc.models.gnn import GNN


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


class GNNTask(pl.LightningModule):
    """Mean squared distance to the truth (paper, eq. "LossGNN").

    In training every batch is turned and mirrored at random, since the network sees directions and the
    source has only those of its own corridors.

    Args:
        network: The GNN.
        learning_rate: Adam's; published 2e-4.
        weight_decay: Adam's.
    """

    def __init__(self, network: GNN, learning_rate: float = 2e-4, weight_decay: float = 1e-5) -> None:
        super().__init__()
        self.network = network
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay

    def training_step(self, batch: dict[str, LabelledIntervals], batch_index: int) -> Tensor:
        """Return the mean loss over the streams of ``batch``."""
        return torch.stack(
            [self._shared_step(part, random_turn(self.device), "train") for part in batch.values()]
        ).mean()

    def validation_step(self, batch: LabelledIntervals, batch_index: int) -> None:
        """Log the loss and the RMSE on held-out intervals."""
        self._shared_step(batch, torch.eye(2, device=self.device), "val")

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return Adam as published."""
        return torch.optim.Adam(self.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay)

    def _shared_step(self, batch: LabelledIntervals, turn: Tensor, stage: str) -> Tensor:
        access_points = batch.access_points @ turn.T
        first = first_estimates(batch.intervals, access_points)
        coarse = self.network(radio_graph(batch.intervals, access_points, first))
        loss = (coarse - batch.positions @ turn.T).square().sum(-1).mean()
        count = len(coarse)
        self.log(f"{stage}/loss", loss, batch_size=count, on_step=False, on_epoch=True)
        if stage == "val":
            self.log("val/mse_m2", loss, batch_size=count, on_step=False, on_epoch=True)
        return loss
