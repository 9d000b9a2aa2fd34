"""What all trainings share: batches come in named streams, the optimiser is the published one."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import lightning.pytorch as pl
import torch
from torch import Tensor, nn

from fploc.datasets.samples import LabelledIntervals


class StreamTask(pl.LightningModule):
    """Training on several streams of labelled intervals at once, measured and virtual.

    On several processes each gets batches of its own: Lightning deals out those of every stream.

    Attributes:
        name: Of the network, as in conf/model/.
        network: What is trained.

    Args:
        learning_rate: Adam's.
        weight_decay: Adam's.
    """

    name: ClassVar[str]

    def __init__(self, network: nn.Module, learning_rate: float, weight_decay: float) -> None:
        super().__init__()
        self.network = network
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay

    def training_step(self, batch: dict[str, LabelledIntervals], batch_index: int) -> Tensor:
        """Return the mean loss over the streams of ``batch``."""
        return torch.stack([self._shared_step(part, "train") for part in batch.values()]).mean()

    def validation_step(self, batch: LabelledIntervals, batch_index: int) -> None:
        """Log the loss and the metrics on held-out intervals."""
        self._shared_step(batch, "val")

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return Adam, as published."""
        return torch.optim.Adam(
            self.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay, foreach=True
        )

    def log_mean(self, name: str, value: Tensor, count: int) -> None:
        """Log a metric's mean over epoch and processes, weighted by the ``count`` of items in the batch."""
        self.log(name, value, batch_size=count, on_step=False, on_epoch=True, sync_dist=True)

    @abstractmethod
    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        """Return the loss of one batch, and log it as ``<stage>/…``."""
