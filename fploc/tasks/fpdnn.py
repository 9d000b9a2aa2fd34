"""Training of FPDNN on links seen from positions as wrong as the GNN's will be."""

from __future__ import annotations

import torch
from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.models.fpdnn import FPDNN
from fploc.tasks.streams import StreamTask


class FPDNNTask(StreamTask):
    """Mean squared error of the distance (paper, eq. "gradient").

    The crop is taken from a coarse position, not from the true one: the truth is moved by Gaussian jitter
    of the size of the GNN's error, one draw per device, since its links share the coarse position.

    Args:
        network: FPDNN.
        jitter_m: Standard deviation of the jitter per axis, metres.
        learning_rate: Adam's.
        weight_decay: Adam's.
    """

    def __init__(
        self,
        network: FPDNN,
        jitter_m: float = 1.0,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-5,
    ) -> None:
        super().__init__(learning_rate, weight_decay)
        self.network = network
        self.jitter_m = jitter_m

    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        links = batch.links
        coarse = batch.positions + self.jitter_m * torch.randn_like(batch.positions)
        crops = self.network.vision.crops.crop(batch.plan, links.access_points, coarse[links.device])
        estimated = self.network(crops.images, crops.lengths_px, links.ranges, links.rss)
        distances = (batch.positions[links.device] - links.access_points).norm(dim=-1)
        loss = torch.nn.functional.mse_loss(estimated, distances)
        count = len(distances)
        self.log_mean(f"{stage}/loss", loss, count)
        absolute = (estimated - distances).abs().mean()
        self.log_mean(f"{stage}/range_mae_m", absolute, count)
        return loss
