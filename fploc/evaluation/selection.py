"""Finding result records by what they are of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fploc.evaluation.records import KALMAN, NO_FILTER, OWN, Record, TrackedRecord
from fploc.evaluation.report import REAL_PLAN, variant_of
from fploc.evaluation.tables import mean_text

FILTERED = (OWN, KALMAN)
"""The method's own filter, or the Kalman filter behind one that has none: nothing is filtered twice."""
UNFILTERED = (NO_FILTER, OWN)


def filtered_once(records: Sequence[TrackedRecord]) -> list[TrackedRecord]:
    """Return the records behind a filter, without those where another one stands behind a method's own."""
    filtering = {one.record.method for one in records if one.record.filter == OWN}
    return [
        one for one in records if one.record.filter == (OWN if one.record.method in filtering else KALMAN)
    ]


@dataclass(frozen=True)
class Slot:
    """What a number in a table is of; the fields of a record but for its seed.

    Args:
        protocol: As in ``Record``, and so all others but ``filters``, ``variant`` and ``thin``.
        site: Target.
        device: 1 or 2.
        method: Name of the method.
        filters: Filters in order of preference: the first that the method has.
        labels: ``repaired`` or ``published``.
        condition: What else differs; empty for nothing.
        plan: Plan that the method saw.
        variant: Ablation of the preset; empty for none.
        thin: Every so many-th interval; None for the least thinned there are.
    """

    protocol: str
    site: str
    device: int
    method: str
    filters: tuple[str, ...] = FILTERED
    labels: str = "repaired"
    condition: str = ""
    plan: str = REAL_PLAN
    variant: str = ""
    thin: int | None = None


class RecordBook:
    """The records of one preset and its variants.

    Args:
        records: Of any presets.
        preset: The one that counts.
    """

    def __init__(self, records: Sequence[TrackedRecord], preset: str) -> None:
        self.records = [
            one.record
            for one in records
            if one.record.preset.partition("--")[0] == preset and not one.record.smoother
        ]
        self.thin = min((one.thin for one in self.records), default=1)
        self._by_slot: dict[Slot, list[Record]] = {}
        for record in self.records:
            self._by_slot.setdefault(_slot_of(record), []).append(record)

    def find(self, slot: Slot) -> list[Record]:
        """Return the records of a slot, one for each seed, in the order of their seeds."""
        for name in slot.filters:
            thin = self.thin if slot.thin is None else slot.thin
            found = self._by_slot.get(replace(slot, filters=(name,), thin=thin), [])
            if found:
                return sorted(found, key=lambda one: one.seed)
        return []

    def values(self, slot: Slot, metric: str) -> list[float]:
        """Return the known values of a metric, one for each seed."""
        return [value for one in self.find(slot) if (value := getattr(one, metric)) is not None]

    def mean(self, slot: Slot, metric: str = "rmse_m") -> float | None:
        """Return the mean of a metric over seeds; None where there is none."""
        values = self.values(slot, metric)
        return float(np.mean(values)) if values else None

    def text(self, slot: Slot, metric: str = "rmse_m") -> str:
        """Return a metric as it stands in tables: mean ± standard deviation over seeds, or a dash."""
        return mean_text(self.values(slot, metric))

    def slots(self, like: Slot) -> Iterator[Slot]:
        """Yield every site, device and method that has a record under the other fields of ``like``."""
        seen = {
            replace(like, site=one.site, device=one.device, method=one.method): None
            for one in self.records
            if one.protocol == like.protocol
        }
        yield from (slot for slot in seen if self.find(slot))


def _slot_of(record: Record) -> Slot:
    return Slot(
        protocol=record.protocol,
        site=record.site,
        device=record.device,
        method=record.method,
        filters=(record.filter,),
        labels=record.labels,
        condition=record.condition,
        plan=record.plan,
        variant=variant_of(record.preset),
        thin=record.thin,
    )
