"""Batches of intervals in random or fixed order."""

from __future__ import annotations

import torch
from torch.utils.data import BatchSampler, DataLoader, RandomSampler, SequentialSampler

from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals


def random_batches(
    intervals: MeasuredIntervals, *, batch_size: int, batches: int, seed: int
) -> DataLoader[LabelledIntervals]:
    """Return a loader of ``batches`` batches an epoch, drawn with replacement from one seeded stream."""
    random = torch.Generator().manual_seed(seed)
    sampler = RandomSampler(intervals, replacement=True, num_samples=batches * batch_size, generator=random)
    return DataLoader(intervals, sampler=BatchSampler(sampler, batch_size, drop_last=True), batch_size=None)


def ordered_batches(intervals: MeasuredIntervals, *, batch_size: int) -> DataLoader[LabelledIntervals]:
    """Return a loader over all intervals in order."""
    sampler = BatchSampler(SequentialSampler(intervals), batch_size, drop_last=False)
    return DataLoader(intervals, sampler=sampler, batch_size=None)
