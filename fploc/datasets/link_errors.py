"""How far every measured range is from the labelled distance, and how many walls stand in between.

Axis: N readings with a range, at a labelled position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fploc.datasets.recordings import Bools, Floats, Recording
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import wall_crossings
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site

Ints = NDArray[np.int64]

IMPOSSIBLE_M = 1.5


@dataclass(frozen=True, eq=False)
class LinkErrors:
    """Readings of one site beside their true distance; ranges beyond 60 m, which are faults, are left out.

    Args:
        access_point: Index into ``Site.access_points``, shape (N,).
        t_s: Device time, shape (N,), seconds.
        place_m: The label, shape (N, 2), metres, site frame.
        range_m: RTT range in space, no offset removed, shape (N,), metres.
        distance_m: Between label and access point in space, shape (N,), metres.
        rss_dbm: Received signal strength, shape (N,), dBm; 0 where unknown.
        walls: Walls that the straight line in the plan crosses, shape (N,).
    """

    access_point: Ints
    t_s: Floats
    place_m: Floats
    range_m: Floats
    distance_m: Floats
    rss_dbm: Floats
    walls: Ints

    @property
    def error_m(self) -> Floats:
        """Range minus distance, shape (N,), metres."""
        return self.range_m - self.distance_m

    @property
    def is_impossible(self) -> Bools:
        """True where the range is shorter than the distance by more than any noise: the label must be wrong."""
        return np.asarray(self.error_m < -IMPOSSIBLE_M, dtype=np.bool_)

    def of_access_point(self, index: int) -> LinkErrors:
        """Return the readings of one access point."""
        own = self.access_point == index
        return LinkErrors(
            access_point=self.access_point[own],
            t_s=self.t_s[own],
            place_m=self.place_m[own],
            range_m=self.range_m[own],
            distance_m=self.distance_m[own],
            rss_dbm=self.rss_dbm[own],
            walls=self.walls[own],
        )


def link_errors(site: Site, plan: FloorPlan, recordings: Sequence[Recording], labels: str) -> LinkErrors:
    """Return the readings of at least one recording, one recording after the other.

    Args:
        site: Where they were made.
        plan: Its plan, for the walls.
        recordings: The recordings.
        labels: ``published`` or ``repaired``.
    """
    positions = np.concatenate([one.labels_m(labels) for one in recordings])
    slant = np.concatenate([one.slant_m for one in recordings])
    rss = np.concatenate([one.rss_dbm for one in recordings])
    time = np.concatenate([one.t_s for one in recordings])
    known = np.isfinite(positions).all(axis=1)[:, None] & (slant > 0.0) & (slant <= FARTHEST_RANGE_M)
    rows, access_points = np.nonzero(known)
    starts, ends = site.positions_m[access_points], positions[rows]
    distance = np.hypot(np.linalg.norm(ends - starts, axis=1), site.height_differences_m[access_points])
    return LinkErrors(
        access_point=access_points,
        t_s=time[rows],
        place_m=ends,
        range_m=slant[known],
        distance_m=distance,
        rss_dbm=rss[known],
        walls=wall_crossings(plan, starts, ends).count,
    )
