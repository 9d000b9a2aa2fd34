"""Two recordings of one lap on one clock, with the readings of the link between their devices.

The devices and the log of their link have clocks of their own. Where a site's files share a zero it is used as
published; ``PairedLap.shifted`` moves it, to show what an error of it does. At each interval of a device the
other's latest interval and the latest reading of the link stand beside it, none older than a stated age, so that
nothing comes from the future.

Axes: T intervals of one device, R readings of the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.datasets.recordings import Bools, Floats, Recording

Indices = NDArray[np.int64]
DEVICES = (1, 2)


@dataclass(frozen=True)
class LinkReadings:
    """Ranges between the two devices of a lap; readings without a range are left out.

    Args:
        t_s: Time of the link's log, shape (R,), seconds.
        ranges_m: As measured, no offset removed, shape (R,), metres.
        rss_dbm: Received signal strength, shape (R,), dBm; NaN where unknown.
    """

    t_s: Floats
    ranges_m: Floats
    rss_dbm: Floats

    def thinned(self, every: int) -> LinkReadings:
        """Return every ``every``-th reading on a clock that runs ``every`` times as fast."""
        return LinkReadings(self.t_s[::every] / every, self.ranges_m[::every], self.rss_dbm[::every])


NO_LINK = LinkReadings(np.array([-np.inf]), np.zeros(1), np.full(1, np.nan))
"""A log that holds nothing of any lap."""


@dataclass(frozen=True)
class PairedLap:
    """One lap of both devices.

    Args:
        name: Of the lap, for example ``7``.
        devices: Recordings of device 1 and of device 2.
        link: What was measured between them.
    """

    name: str
    devices: tuple[Recording, Recording]
    link: LinkReadings

    def thinned(self, every: int) -> PairedLap:
        """Return every ``every``-th interval of each device, all clocks running ``every`` times as fast.

        ``Recording.thinned`` keeps the first time steps instead, which no longer fit each other where
        devices have gaps.
        """
        first, second = (replace(one.thinned(every), t_s=one.t_s[::every] / every) for one in self.devices)
        return PairedLap(self.name, (first, second), self.link.thinned(every))

    def shifted(self, *, link_s: float = 0.0, second_s: float = 0.0) -> PairedLap:
        """Return the lap with the clocks of the link and of device 2 set forward, seconds.

        No device's time is below 0: where device 2 is set back, everything else is set forward.
        """
        first, second = self.devices
        ahead_s = max(0.0, -second_s)
        return PairedLap(
            self.name,
            (replace(first, t_s=first.t_s + ahead_s), replace(second, t_s=second.t_s + second_s + ahead_s)),
            replace(self.link, t_s=self.link.t_s + link_s + ahead_s),
        )


def paired_laps(recordings: Sequence[Recording], device_links: pd.DataFrame) -> list[PairedLap]:
    """Return the laps that both devices and the link between them have a recording of, by name.

    A lap's recordings are named after it and two digits: lap 7 belongs to recordings 713 and 724.

    Args:
        recordings: Of one site.
        device_links: Table ``fploc.schema.DEVICE_LINKS``.
    """
    by_lap = {(one.name[:-2], one.device): one for one in recordings}
    laps = []
    for name, rows in device_links[device_links["range_m"].notna()].groupby("lap", sort=True):
        lap = str(name)
        if all((lap, device) in by_lap for device in DEVICES):
            columns = (rows[column].to_numpy() for column in ("range_m", "rss_dbm"))
            link = LinkReadings(rows["t_ms"].to_numpy() / 1000.0, *columns)
            first, second = (by_lap[lap, device] for device in DEVICES)
            laps.append(PairedLap(lap, (first, second), link))
    return laps


def latest_before(times_s: Floats, at_s: Floats, oldest_s: float) -> tuple[Indices, Bools]:
    """Return the latest of ``times_s`` up to each of ``at_s``, and whether it is young enough.

    Args:
        times_s: In order, shape (R,), seconds.
        at_s: Shape (T,), seconds.
        oldest_s: Greatest age, seconds.

    Returns:
        Indices into ``times_s``, shape (T,), 0 where there is none, and True where its age is at most
        ``oldest_s``, shape (T,).
    """
    found = np.searchsorted(times_s, at_s, side="right") - 1
    index = np.maximum(found, 0)
    if len(times_s) == 0:
        return index, np.zeros(len(at_s), dtype=np.bool_)
    return index, (found >= 0) & (at_s - times_s[index] <= oldest_s)
