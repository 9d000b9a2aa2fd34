"""Which method is best where: one line of numbers for each method of a protocol, for a comparison at a glance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.report import headline_records
from fploc.evaluation.selection import filtered_once

LABELS = "repaired"
EVERYWHERE = "all sites"

Overview = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Protocol → method → name of a number → its value."""


def overview(records: Sequence[TrackedRecord]) -> Overview:
    """Return the RMSE of every method at every site and device, mean over seeds, metres.

    Headline records against repaired labels, behind the filter over time or the method's own. A number is named
    ``SITE/device N rmse_m``. Under ``EVERYWHERE`` stands the mean over places where every method of the protocol was
    scored. A place without any fix has no number.

    Args:
        records: Of one preset.
    """
    values: dict[str, dict[str, dict[str, list[float]]]] = {}
    for tracked in filtered_once(headline_records(records)):
        one = tracked.record
        if one.labels == LABELS and one.rmse_m is not None:
            methods = values.setdefault(one.protocol, {})
            place = f"{one.site}/device {one.device} rmse_m"
            methods.setdefault(one.method, {}).setdefault(place, []).append(one.rmse_m)
    return {protocol: _with_means(methods) for protocol, methods in values.items()}


def _with_means(methods: Mapping[str, Mapping[str, Sequence[float]]]) -> dict[str, dict[str, float]]:
    shared = set.intersection(*(set(places) for places in methods.values()))
    means = {
        name: {place: float(np.mean(values)) for place, values in places.items()}
        for name, places in methods.items()
    }
    if not shared:
        return means
    return {
        name: {f"{EVERYWHERE}/rmse_m": float(np.mean([own[place] for place in shared])), **own}
        for name, own in means.items()
    }
