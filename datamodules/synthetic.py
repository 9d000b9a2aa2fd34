"""Intervals of a virtual site as batches: a plan, access points and the generator, no measurement."""

from __future__ import annotations

import lightning.pytorch as pl
from torch.utils.data import DataLoader

from fploc.datasets.samples import LabelledIntervals
from fploc.virtual.site import VirtualIntervals, VirtualSite


class SyntheticDataModule(pl.LightningDataModule):
    """Virtual intervals for training, and others of the same site for validation.

    Args:
        site: The virtual site.
        pairs: Pairs of devices in a batch.
        batches: Training batches of an epoch.
        validation_batches: Batches of validation, the same in every epoch.
        seed: Seed of both streams.
    """

    def __init__(
        self, site: VirtualSite, pairs: int, batches: int, validation_batches: int, seed: int
    ) -> None:
        super().__init__()
        self.site = site
        self.pairs = pairs
        self.batches = batches
        self.validation_batches = validation_batches
        self.seed = seed

    def train_dataloader(self) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches, by name as tasks take it."""
        stream = VirtualIntervals(self.site, self.pairs, self.batches, seed=2 * self.seed)
        return {"virtual": DataLoader(stream, batch_size=None)}

    def val_dataloader(self) -> DataLoader[LabelledIntervals]:
        """Return validation batches, drawn once."""
        stream = VirtualIntervals(self.site, self.pairs, self.validation_batches, seed=2 * self.seed + 1)
        drawn: list[LabelledIntervals] = list(stream)
        return DataLoader(drawn, batch_size=None)  # type: ignore[arg-type]
