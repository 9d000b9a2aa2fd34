"""Batches of intervals in random, balanced or fixed order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch.utils.data import BatchSampler, DataLoader, Dataset, RandomSampler, Sampler, SequentialSampler

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


class BalancedBatches(Sampler[tuple[int, list[int]]]):
    """Draws batches of a few sets of intervals, grouped by place and site, each level with equal chances.

    Args:
        places: Number of intervals of every set: places, their sites, the sets of these.
        batch_size: Intervals of a batch, with replacement.
        batches: Batches of an epoch.
        seed: Of one stream that all epochs go on with.
    """

    def __init__(
        self, places: Sequence[Sequence[Sequence[int]]], batch_size: int, batches: int, seed: int
    ) -> None:
        self.places = places
        self.batch_size = batch_size
        self.batches = batches
        self.random = torch.Generator().manual_seed(seed)
        numbers = iter(range(sum(len(site) for place in places for site in place)))
        self.numbers = [[[next(numbers) for _ in site] for site in place] for place in places]

    def __iter__(self) -> Iterator[tuple[int, list[int]]]:
        for _ in range(self.batches):
            place = self._one_of(len(self.places))
            site = self._one_of(len(self.places[place]))
            chosen = self._one_of(len(self.places[place][site]))
            size = self.places[place][site][chosen]
            rows = torch.randint(size, (self.batch_size,), generator=self.random)
            yield self.numbers[place][site][chosen], rows.tolist()

    def __len__(self) -> int:
        return self.batches

    def _one_of(self, number: int) -> int:
        return int(torch.randint(number, (), generator=self.random))


class _SeveralSets(Dataset[LabelledIntervals]):
    """Sets of intervals; an index is the number of a set and a list of its intervals."""

    def __init__(self, sets: Sequence[MeasuredIntervals]) -> None:
        self.sets = sets

    def __getitem__(self, index: tuple[int, list[int]]) -> LabelledIntervals:
        number, rows = index
        return self.sets[number][rows]


def balanced_batches(
    places: Sequence[Sequence[Sequence[MeasuredIntervals]]], *, batch_size: int, batches: int, seed: int
) -> DataLoader[LabelledIntervals]:
    """Return a loader of ``batches`` batches an epoch, each of one set; see ``BalancedBatches``.

    Args:
        places: Sets of intervals, by place and site.
        batch_size: Intervals of a batch.
        batches: Batches of an epoch.
        seed: Of the draws.
    """
    sizes = [[[len(one) for one in site] for site in place] for place in places]
    sets = [one for place in places for site in place for one in site]
    sampler = BalancedBatches(sizes, batch_size, batches, seed)
    return DataLoader(_SeveralSets(sets), sampler=sampler, batch_size=None)
