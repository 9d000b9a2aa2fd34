from __future__ import annotations

import torch

from fploc.intervals import Intervals
from fploc.methods.trilateration import trilateration
from rooms import room

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SITE = room(CORNERS)


def test_the_farthest_of_four_does_not_count() -> None:
    truth = torch.tensor([[4.0, 5.0]], dtype=torch.float64)
    ranges = torch.cdist(truth, torch.tensor(CORNERS, dtype=torch.float64))
    ranges[0, 2] += 30.0
    here = torch.ones(1, dtype=torch.bool)
    blank = torch.zeros_like(ranges)
    method = trilateration()
    _, found = method.step(
        method.init(SITE, 1), Intervals(here.double(), ranges, blank, blank, ranges > 0, here)
    )
    torch.testing.assert_close(found.positions, truth)
