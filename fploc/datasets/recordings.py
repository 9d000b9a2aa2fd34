"""Recordings as dense arrays: the form that solvers, networks and the localizer take.

Axes: B recordings, T intervals, A access points (order of ``Site.access_points``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.sites.site import Site

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Recording:
    """One lap of one device.

    Args:
        site: Name of the site.
        device: 1 or 2.
        name: Name of the lap's file, for example ``713``.
        t_s: Device time, shape (T,), seconds.
        slant_m: RTT range in space, no offset removed, shape (T, A), metres; 0 where not heard.
        std_m: The phone's own spread, shape (T, A), metres; 0 where unknown.
        rss_dbm: Shape (T, A), dBm; 0 where not heard.
        heard: True where there is a range below 100 m, shape (T, A).
        published_m: Ground truth as published, shape (T, 2), metres, site frame; NaN where none.
        repaired_m: Ground truth after repair, shape (T, 2), metres, site frame; NaN where none.
    """

    site: str
    device: int
    name: str
    t_s: Floats
    slant_m: Floats
    std_m: Floats
    rss_dbm: Floats
    heard: Bools
    published_m: Floats
    repaired_m: Floats

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def key(self) -> str:
        """Name among those of all sites, ``site/device/name``: what artifacts and offsets were fitted on."""
        return f"{self.site}/{self.device}/{self.name}"

    def labels_m(self, kind: str) -> Floats:
        """Return the ground truth of the kind ``published`` or ``repaired``, shape (T, 2)."""
        return {"published": self.published_m, "repaired": self.repaired_m}[kind]

    def thinned(self, every: int) -> Recording:
        """Return every ``every``-th interval with the original time step: a robot ``every`` times as fast."""
        kept = self._at(slice(None, None, every))
        return replace(kept, t_s=self.t_s[: len(kept)])

    def where(self, mask: Bools) -> Recording:
        """Return the intervals of a mask, shape (T,), at their own times."""
        return self._at(mask)

    def hearing(self, heard: Bools) -> Recording:
        """Return the recording with nothing but what ``heard`` allows, shape (T, A) or (A,)."""
        heard = self.heard & heard
        return replace(
            self,
            slant_m=np.where(heard, self.slant_m, 0.0),
            std_m=np.where(heard, self.std_m, 0.0),
            rss_dbm=np.where(heard, self.rss_dbm, 0.0),
            heard=heard,
        )

    def _at(self, kept: slice | Bools) -> Recording:
        return replace(
            self,
            t_s=self.t_s[kept],
            slant_m=self.slant_m[kept],
            std_m=self.std_m[kept],
            rss_dbm=self.rss_dbm[kept],
            heard=self.heard[kept],
            published_m=self.published_m[kept],
            repaired_m=self.repaired_m[kept],
        )


def dense_recordings(site: Site, readings: pd.DataFrame, intervals: pd.DataFrame) -> list[Recording]:
    """Return the recordings of a packed site, ordered by device and name."""
    column = {mac: index for index, mac in enumerate(site.macs)}
    groups = dict(list(readings.groupby(["device", "recording"], sort=True)))
    recordings = []
    for key, rows in intervals.groupby(["device", "recording"], sort=True):
        rows = rows.sort_values("interval")
        shape = (len(rows), len(column))
        slant, std, rss = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        if key in groups:
            cells = groups[key]
            position = np.searchsorted(rows["interval"].to_numpy(), cells["interval"].to_numpy())
            at = (position, cells["mac"].map(column).to_numpy())
            slant[at] = cells["range_slant_m"].fillna(0.0)
            std[at] = cells["range_std_m"].fillna(0.0)
            rss[at] = cells["rss_dbm"].fillna(0.0)
        device, name = cast(tuple[int, str], key)
        recordings.append(
            Recording(
                site=site.name,
                device=int(device),
                name=str(name),
                t_s=rows["t_ms"].to_numpy() / 1000.0,
                slant_m=slant,
                std_m=std,
                rss_dbm=rss,
                heard=slant > 0.0,
                published_m=rows[["x_published_m", "y_published_m"]].to_numpy(),
                repaired_m=rows[["x_repaired_m", "y_repaired_m"]].to_numpy(),
            )
        )
    return recordings


@dataclass(frozen=True)
class PaddedRecordings:
    """Recordings side by side, padded at their ends: arrays of shape (T, B, …), time first.

    ``present`` is True where a recording has an interval, shape (T, B); everything else is as in
    ``Recording``.
    """

    t_s: Floats
    slant_m: Floats
    std_m: Floats
    rss_dbm: Floats
    heard: Bools
    present: Bools


def pad(recordings: Sequence[Recording]) -> PaddedRecordings:
    """Return ``recordings`` as one batch, time first."""
    longest = max(len(recording) for recording in recordings)

    def padded(name: str) -> NDArray[Any]:
        arrays = [getattr(recording, name) for recording in recordings]
        return np.stack(
            [np.pad(array, [(0, longest - len(array))] + [(0, 0)] * (array.ndim - 1)) for array in arrays],
            axis=1,
        )

    lengths = np.array([len(recording) for recording in recordings])
    return PaddedRecordings(
        t_s=padded("t_s"),
        slant_m=padded("slant_m"),
        std_m=padded("std_m"),
        rss_dbm=padded("rss_dbm"),
        heard=padded("heard"),
        present=np.arange(longest)[:, None] < lengths,
    )
