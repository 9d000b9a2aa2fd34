"""A site of three access points, and laps of it as the public files write them."""

from __future__ import annotations

import pytest

from fploc.sites.site import AccessPoint, Site


@pytest.fixture
def site() -> Site:
    macs = ("b0:e4:d5:39:26:89", "cc:f4:11:8b:29:4d", "b0:e4:d5:96:3b:95")
    return Site(
        name="three",
        place="three",
        access_points=tuple(
            AccessPoint(name=name, mac=mac, x_m=x, y_m=0.0, height_m=1.5)
            for name, mac, x in zip(("AP1", "AP2", "AP5"), macs, (0.0, 4.0, 8.0), strict=True)
        ),
        device_height_m=1.0,
    )
