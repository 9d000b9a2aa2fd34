"""Recordings as the messages that a phone would have sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fploc.datasets.recordings import Recording
from fploc.serve.messages import Interval, Reading, Truth
from fploc.sites.site import Site


def recorded_intervals(recording: Recording, site: Site) -> list[Interval]:
    """Return every interval of a recording as a phone would send it, with the repaired truth beside it."""
    t_ms = recording.t_s * 1000.0
    return [
        Interval(
            t_ms=float(t_ms[index]),
            readings=_readings(recording, site, index),
            truth=_truth(recording.repaired_m[index]),
        )
        for index in range(len(recording))
    ]


def _readings(recording: Recording, site: Site, index: int) -> list[Reading]:
    heard, rss = recording.heard[index], recording.rss_dbm[index]
    columns = np.flatnonzero(heard | (rss != 0.0)).tolist()
    return [
        Reading(
            bssid=site.macs[column],
            range_m=float(recording.slant_m[index, column]) if heard[column] else None,
            range_std_m=float(recording.std_m[index, column]),
            rss_dbm=float(rss[column]),
        )
        for column in columns
    ]


def _truth(place_m: NDArray[np.float64]) -> Truth | None:
    if not np.isfinite(place_m).all():
        return None
    return Truth(x_m=float(place_m[0]), y_m=float(place_m[1]))
