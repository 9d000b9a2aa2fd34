"""Intervals of a virtual site as batches: a plan, access points and the generator, no measurement."""

from __future__ import annotations

import lightning.pytorch as pl
import torch
from torch.utils.data import DataLoader, RandomSampler

from fploc.datasets.samples import LabelledIntervals
from fploc.virtual.site import VirtualIntervals, VirtualSite


class SyntheticDataModule(pl.LightningDataModule):
    """Virtual intervals, drawn once into a pool that every epoch takes its batches from at random.

    Drawing a batch costs as much as learning from it; a pool serves all networks and epochs.

    Args:
        site: The virtual site.
        pairs: Pairs of devices in a batch.
        batches: Training batches of an epoch.
        pool_batches: Batches drawn.
        seed: Seed of the draws and of their order.
    """

    def __init__(self, site: VirtualSite, pairs: int, batches: int, pool_batches: int, seed: int) -> None:
        super().__init__()
        self.site = site
        self.pairs = pairs
        self.batches = batches
        self.pool_batches = pool_batches
        self.seed = seed
        self.pool: list[LabelledIntervals] = []

    def setup(self, stage: str | None = None) -> None:
        """Draw the pool, where it is not drawn yet."""
        if not self.pool:
            self.pool = list(VirtualIntervals(self.site, self.pairs, self.pool_batches, seed=self.seed))

    def train_dataloader(self) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches, by name as tasks take it."""
        random = torch.Generator().manual_seed(self.seed)
        sampler = RandomSampler(self.pool, replacement=True, num_samples=self.batches, generator=random)
        return {"virtual": DataLoader(self.pool, sampler=sampler, batch_size=None)}  # type: ignore[arg-type]
