"""Maps of what the generator expects: mean range error and signal strength of each access point."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.floorplan.grid import PlaceGrid
from fploc.models.generator import MeasurementDistribution
from fploc.virtual.site import CLEARANCE_M, VirtualSite

Floats = NDArray[np.float64]

LINKS_AT_ONCE = 4096
MAP_STEP_M = 0.25
# A cell's centre is then nearer to some free place in it than any wall is: no map looks from inside a wall.
assert MAP_STEP_M / 2**0.5 < CLEARANCE_M


@dataclass(frozen=True, eq=False)
class GeneratorMaps:
    """Conditional means of the generator over the free space of a plan.

    Args:
        grid: The cells.
        range_error_m: E[ζ − d], shape (A, rows, columns), metres; NaN where the plan is not free.
        rss_dbm: E[γ], shape (A, rows, columns), dBm; NaN where the plan is not free.
    """

    grid: PlaceGrid
    range_error_m: Floats
    rss_dbm: Floats


def generator_maps(site: VirtualSite) -> GeneratorMaps:
    """Return the maps of every access point of a virtual site, from the site's own layout."""
    grid = PlaceGrid.covering(site.cells, MAP_STEP_M)
    places = grid.centres_m(np.unique(grid.cells_of(site.cells)))
    means = distribution_between(site, torch.tensor(places, dtype=torch.float32))
    shape = (len(places), len(site.access_points))
    error, rss = (
        grid.means(places, mean.double().numpy().reshape(shape))
        for mean in (means.mean_error(), means.mean_rss())
    )
    return GeneratorMaps(grid, error, rss)


@torch.no_grad()
def distribution_between(site: VirtualSite, places: Tensor) -> MeasurementDistribution:
    """Return what devices at ``places`` (N, 2), metres, would measure: N·A links, access points fastest."""
    N, A = len(places), len(site.access_points)
    starts, ends = site.access_points.repeat(N, 1), places.repeat_interleave(A, dim=0)
    # Links of like length share a batch: crops are as long as the longest of it.
    order = (ends - starts).norm(dim=-1).argsort(stable=True)
    parts = [site.distribution(starts[chunk], ends[chunk]) for chunk in order.split(LINKS_AT_ONCE)]
    back = order.argsort()
    return MeasurementDistribution(
        **{
            field.name: torch.cat([getattr(part, field.name) for part in parts])[back]
            for field in fields(MeasurementDistribution)
        }
    )
