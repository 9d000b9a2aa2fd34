"""A site: access points, heights and the frame that positions are given in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class AccessPoint:
    """One access point; position in metres, site frame, height in metres above the floor."""

    name: str
    mac: str
    x_m: float
    y_m: float
    height_m: float


@dataclass(frozen=True)
class Site:
    """What every method may know of a building before the first measurement, but for the plan's image.

    Args:
        name: Name of the AP layout, for example ``shopping-mall``.
        place: Sites of one place share walls (the office floor) and are never split between
            training and testing when sites are pooled.
        access_points: In a fixed order: the axis A of every array.
        device_height_m: Height of the phones above the floor, metres.
        made_up: True where the building was generated; everything made from it is labelled so.
    """

    name: str
    place: str
    access_points: tuple[AccessPoint, ...]
    device_height_m: float
    made_up: bool = False

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """Access point positions, shape (A, 2), metres, site frame."""
        return np.array([(ap.x_m, ap.y_m) for ap in self.access_points], dtype=np.float64)

    @property
    def height_differences_m(self) -> NDArray[np.float64]:
        """Height of each access point above the devices, shape (A,), metres."""
        return np.array([ap.height_m - self.device_height_m for ap in self.access_points])

    @property
    def macs(self) -> tuple[str, ...]:
        """BSSIDs in the order of the axis A."""
        return tuple(ap.mac for ap in self.access_points)
