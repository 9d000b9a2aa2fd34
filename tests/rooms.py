"""Sites that tests of several folders stand in."""

from __future__ import annotations

from collections.abc import Sequence

from fploc.sites.site import AccessPoint, Site


def room(places: Sequence[tuple[float, float]], *, height_m: float = 2.0) -> Site:
    """Return a site with access points at ``places``, metres, all of one height, and devices at 1 m."""
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, height_m)
            for index, (x, y) in enumerate(places)
        ),
        device_height_m=1.0,
    )
