"""Labelled intervals of a drawn hall: what both kinds of stream give to a training."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from fploc.datasets.samples import LabelledIntervals
from fploc.floorplan.raster import PlanRaster
from fploc.intervals import DeviceLinks, Intervals

ACCESS_POINTS = torch.tensor([[0.0, 0.0], [16.0, 0.0], [16.0, 10.0], [0.0, 10.0], [7.0, 6.0]])

MakeBatch = Callable[..., LabelledIntervals]


@pytest.fixture
def make_batch() -> MakeBatch:
    """Return a maker of batches: ``seed``, ``bias_m`` of every range, and whether ``linked`` in pairs."""

    def make(seed: int, *, bias_m: float = 0.5, linked: bool = False, devices: int = 8) -> LabelledIntervals:
        random = torch.Generator().manual_seed(seed)
        positions = torch.rand(devices, 2, generator=random) * torch.tensor([16.0, 10.0])
        heard = torch.rand(devices, 5, generator=random) < 0.9
        heard[:, :3] = True
        distances = (positions[:, None] - ACCESS_POINTS).norm(dim=-1)
        ink = torch.zeros(110, 170)
        ink[:, 80:83] = 1.0
        even = torch.arange(0, devices, 2)
        index = torch.stack([torch.cat([even, even + 1]), torch.cat([even + 1, even])])
        links = DeviceLinks(
            index=index,
            ranges=(positions[index[0]] - positions[index[1]]).norm(dim=-1) + bias_m,
            rss=torch.full((devices,), -55.0),
        )
        return LabelledIntervals(
            plan=PlanRaster(
                ink=ink, pixels_from_metres=torch.tensor([[10.0, 0.0, 4.5], [0.0, -10.0, 104.5]])
            ),
            access_points=ACCESS_POINTS,
            intervals=Intervals(
                t_s=torch.zeros(devices, dtype=torch.float64),
                ranges=(distances + bias_m) * heard,
                stds=torch.zeros(devices, 5),
                rss=(-40 - 2 * distances) * heard,
                heard=heard,
                present=torch.ones(devices, dtype=torch.bool),
                links=links if linked else None,
            ),
            positions=positions,
        )

    return make
