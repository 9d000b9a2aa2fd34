"""Training of the generator on measured links."""

from __future__ import annotations

import lightning.pytorch as pl
import torch
from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.models.generator import Generator


class GeneratorTask(pl.LightningModule):
    """Maximum likelihood of range error and signal strength given true distance and crop.

    The paper's loss adds m² and dB² (eq. "gradient_rttrss"); a likelihood weighs both by their own spread
    and learns the spread as well.

    Args:
        network: The generator.
        learning_rate: Adam's.
        weight_decay: Adam's.
    """

    def __init__(
        self,
        network: Generator,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-5,
    ) -> None:
        super().__init__()
        self.network = network
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay

    def training_step(self, batch: dict[str, LabelledIntervals], batch_index: int) -> Tensor:
        """Return the mean loss over the streams of ``batch``."""
        return torch.stack([self._shared_step(part, "train") for part in batch.values()]).mean()

    def validation_step(self, batch: LabelledIntervals, batch_index: int) -> None:
        """Log the loss and the error of the mean on held-out links."""
        self._shared_step(batch, "val")

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return Adam as published."""
        return torch.optim.Adam(self.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay)

    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        links = batch.links
        ends = batch.positions[links.device]
        crops = self.network.vision.crops.crop(batch.plan, links.access_points, ends)
        distances = (ends - links.access_points).norm(dim=-1)
        errors = links.ranges - distances
        distribution = self.network(crops.images, crops.lengths_px, distances)
        loss = -(distribution.log_prob_error(errors) + distribution.log_prob_rss(links.rss, errors)).mean()
        count = len(distances)
        self.log(f"{stage}/nll", loss, batch_size=count, on_step=False, on_epoch=True)
        absolute = (distribution.mean_error() - errors).abs().mean()
        self.log(f"{stage}/range_mae_m", absolute, batch_size=count, on_step=False, on_epoch=True)
        return loss
