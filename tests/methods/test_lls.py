from __future__ import annotations

from dataclasses import replace

import torch

from fploc.intervals import Intervals
from fploc.methods.lls import LlsSettings, lls
from rooms import room

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SITE = room(CORNERS)


def test_the_reference_is_the_nearest_access_point_and_its_error_weighs_on_all_rows() -> None:
    ranges = torch.tensor([[5.0, 17.0, 19.0, 11.5]], dtype=torch.float64)
    here = torch.ones(1, dtype=torch.bool)
    blank = torch.zeros_like(ranges)
    method = lls(replace(LlsSettings.read(), sigma_m=0.5, sigma_per_m=0.1))
    _, found = method.step(
        method.init(SITE, 1), Intervals(here.double(), ranges, blank, blank, ranges > 0, here)
    )
    places = torch.tensor(CORNERS, dtype=torch.float64)
    rows = 2 * (places[1:] - places[0])
    right = ranges[0, 0] ** 2 - ranges[0, 1:] ** 2 + places[1:].square().sum(-1)
    variances = (0.5 + 0.1 * ranges[0]).square()
    own = 4 * ranges[0].square() * variances + 2 * variances.square()
    whitened = torch.linalg.inv(torch.linalg.cholesky(own[0] + own[1:].diag()))
    expected = torch.linalg.lstsq(whitened @ rows, whitened @ right[:, None]).solution[:, 0]
    torch.testing.assert_close(found.positions[0], expected)
