from __future__ import annotations

import torch

from fploc.intervals import Intervals
from fploc.methods.lls import lls
from fploc.sites.site import AccessPoint, Site

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SITE = Site(
    name="box",
    place="box",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 2.0)
        for index, (x, y) in enumerate(CORNERS)
    ),
    device_height_m=1.0,
)


def test_the_reference_is_the_nearest_access_point() -> None:
    ranges = torch.tensor([[5.0, 17.0, 19.0, 11.5]], dtype=torch.float64)
    here = torch.ones(1, dtype=torch.bool)
    blank = torch.zeros_like(ranges)
    method = lls()
    _, found = method.step(
        method.init(SITE, 1), Intervals(here.double(), ranges, blank, blank, ranges > 0, here)
    )
    places = torch.tensor(CORNERS, dtype=torch.float64)
    rows = 2 * (places[1:] - places[0])
    right = ranges[0, 0] ** 2 - ranges[0, 1:] ** 2 + places[1:].square().sum(-1)
    expected = torch.linalg.lstsq(rows, right[:, None]).solution[:, 0]
    torch.testing.assert_close(found.positions[0], expected)
