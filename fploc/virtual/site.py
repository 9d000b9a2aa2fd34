"""A virtual site: a real plan on which the generator says what phones would measure."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.utils.data import IterableDataset

from fploc.datasets.samples import LabelledIntervals
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import CropSettings, PlanRaster
from fploc.floorplan.walls import free_space, line_of_sight
from fploc.intervals import DeviceLinks, Intervals
from fploc.models.generator import Generator, MeasurementDistribution
from fploc.sites.site import Site
from fploc.virtual.dropout import Dropout

CLEARANCE_M = 0.3


class VirtualSite:
    """Draws intervals of phones at random places of a plan (paper, section "Synthetic Data Generation").

    Positions lie in the plan's free space, at least 0.3 m from walls and reachable from the access points.
    Access points stand where the site's do or, in a share of the draws, anywhere in the free space.
    Devices come in pairs; a pair in line of sight of each other measures the range between them.

    Args:
        site: Access points; no measurement of the site is used.
        plan: Its plan.
        generator: The trained generator; evaluated without dropout.
        crops: How the generator sees the plan.
        dropout: How often a link is heard.
        random_layout_share: Share of draws with access points elsewhere, from 0 to 1.

    Raises:
        FplocError: If the plan has no free space near the access points.
    """

    def __init__(
        self,
        site: Site,
        plan: FloorPlan,
        generator: Generator,
        crops: CropSettings,
        dropout: Dropout,
        random_layout_share: float,
    ) -> None:
        self.plan = plan
        self.raster = PlanRaster.of(plan)
        self.softened = crops.softened(self.raster)
        self.access_points = torch.tensor(site.positions_m, dtype=torch.float32)
        self.generator = generator.eval()
        self.crops = crops
        self.dropout = dropout
        self.random_layout_share = random_layout_share
        free = torch.from_numpy(free_space(plan, site.positions_m, clearance_m=CLEARANCE_M))
        rows, columns = torch.nonzero(free, as_tuple=True)
        cells = plan.georeference.to_metres(torch.stack([columns, rows], dim=-1).numpy())
        self.cells = torch.tensor(cells, dtype=torch.float32)

    @torch.no_grad()
    def draw(self, pairs: int, random: torch.Generator) -> LabelledIntervals:
        """Return labelled intervals of ``pairs`` pairs of devices; devices 2i and 2i + 1 are a pair."""
        access_points = self.layout(random)
        positions = self.places(2 * pairs, random)
        B, A = len(positions), len(access_points)
        starts = access_points.repeat(B, 1)
        ends = positions.repeat_interleave(A, dim=0)
        ranges, rss = self.measure(starts, ends, random)
        distances = (ends - starts).norm(dim=-1)
        heard = self.dropout.sample(distances, random).reshape(B, A)
        return LabelledIntervals(
            plan=self.raster,
            access_points=access_points,
            intervals=Intervals(
                t_s=torch.zeros(B, dtype=torch.float64),
                ranges=ranges.reshape(B, A) * heard,
                stds=torch.zeros(B, A),
                rss=rss.reshape(B, A) * heard,
                heard=heard,
                present=torch.ones(B, dtype=torch.bool),
                links=self.device_links(positions, random),
            ),
            positions=positions,
        )

    def layout(self, random: torch.Generator) -> Tensor:
        """Return positions of the access points of one draw, shape (A, 2), metres."""
        elsewhere = float(torch.rand((), generator=random)) < self.random_layout_share
        return self.places(len(self.access_points), random) if elsewhere else self.access_points

    def places(self, number: int, random: torch.Generator) -> Tensor:
        """Return random places in the free space, shape (``number``, 2), metres."""
        return self.cells[torch.randint(len(self.cells), (number,), generator=random)]

    def measure(self, starts: Tensor, ends: Tensor, random: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return calibrated plan ranges (L,) in metres and RSS (L,) in dBm of links (L, 2) to (L, 2)."""
        distances = (ends - starts).norm(dim=-1)
        errors, rss = self.distribution(starts, ends).sample(random)
        return (distances + errors).clamp(min=0.0), rss

    def distribution(self, starts: Tensor, ends: Tensor) -> MeasurementDistribution:
        """Return what links (L, 2) to (L, 2), metres, would measure."""
        crops = self.crops.crop_softened(self.softened, starts, ends)
        made: MeasurementDistribution = self.generator(
            crops.images, crops.lengths_px, (ends - starts).norm(dim=-1)
        )
        return made

    def device_links(self, positions: Tensor, random: torch.Generator) -> DeviceLinks:
        """Return the links of pairs that see each other, both ways, the same range and RSS each way."""
        first, second = positions[0::2], positions[1::2]
        seen = torch.from_numpy(line_of_sight(self.plan, first.numpy(), second.numpy()))
        pair = torch.nonzero(seen)[:, 0]
        ranges, rss = self.measure(first[pair], second[pair], random)
        there = torch.stack([2 * pair, 2 * pair + 1])
        return DeviceLinks(
            index=torch.cat([there, there.flip(0)], dim=1), ranges=ranges.repeat(2), rss=rss.repeat(2)
        )


class VirtualIntervals(IterableDataset[LabelledIntervals]):
    """An endless source of virtual intervals, cut into epochs; every epoch differs, one seed repeats all.

    Args:
        site: The virtual site.
        pairs: Pairs of devices in a batch.
        batches: Batches in an epoch.
        seed: Seed of the stream.
    """

    def __init__(self, site: VirtualSite, pairs: int, batches: int, seed: int) -> None:
        self.site = site
        self.pairs = pairs
        self.batches = batches
        self.random = torch.Generator().manual_seed(seed)

    def __iter__(self) -> Iterator[LabelledIntervals]:
        for _ in range(self.batches):
            yield self.site.draw(self.pairs, self.random)

    def __len__(self) -> int:
        return self.batches
