"""Torch data sets of labelled intervals: what networks learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from fploc.datasets.recordings import Floats, Recording
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import PlanRaster
from fploc.intervals import Intervals, Links, links_of
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site


@dataclass(frozen=True)
class LabelledIntervals:
    """Intervals of one site with the positions that they were measured at.

    Args:
        plan: The site's plan.
        access_points: Shape (A, 2), metres, site frame.
        intervals: One interval of each of B devices.
        positions: Ground truth, shape (B, 2), metres, site frame.
    """

    plan: PlanRaster
    access_points: Tensor
    intervals: Intervals
    positions: Tensor

    def to(self, device: torch.device | str) -> LabelledIntervals:
        """Return the batch on ``device``: Lightning's way to move a batch."""
        return LabelledIntervals(
            plan=self.plan.to(device),
            access_points=self.access_points.to(device),
            intervals=self.intervals.to(device),
            positions=self.positions.to(device),
        )

    @property
    def links(self) -> Links:
        """The links of the batch."""
        return links_of(self.intervals, self.access_points)


class MeasuredIntervals(Dataset[LabelledIntervals]):
    """Recordings of one site as labelled intervals; an index is a list of intervals.

    Intervals without a label or a range are left out, as are ranges beyond 60 m, which are faults.

    Args:
        recordings: Recordings of one site.
        ranges: Calibrated range in the plan of each recording, shape (T, A), metres.
        site: The site.
        plan: Its plan.
        labels: ``published`` or ``repaired``.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        ranges: Sequence[Floats],
        site: Site,
        plan: FloorPlan,
        labels: str,
    ) -> None:
        slant = np.concatenate([recording.slant_m for recording in recordings])
        rss = np.concatenate([recording.rss_dbm for recording in recordings])
        std = np.concatenate([recording.std_m for recording in recordings])
        positions = np.concatenate([recording.labels_m(labels) for recording in recordings])
        time = np.concatenate([recording.t_s for recording in recordings])
        heard = np.concatenate([recording.heard for recording in recordings])
        heard &= slant <= FARTHEST_RANGE_M
        usable = np.isfinite(positions).all(axis=1) & heard.any(axis=1)
        calibrated = np.where(heard, np.concatenate(list(ranges)), 0.0)
        self.plan = PlanRaster.of(plan)
        self.access_points = torch.tensor(site.positions_m, dtype=torch.float32)
        self.t_s = torch.tensor(time[usable])
        self.ranges = torch.tensor(calibrated[usable], dtype=torch.float32)
        self.stds = torch.tensor(np.where(heard, std, 0.0)[usable], dtype=torch.float32)
        self.rss = torch.tensor(np.where(heard, rss, 0.0)[usable], dtype=torch.float32)
        self.heard = torch.tensor(heard[usable])
        self.positions = torch.tensor(positions[usable], dtype=torch.float32)

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, index: list[int]) -> LabelledIntervals:
        return LabelledIntervals(
            plan=self.plan,
            access_points=self.access_points,
            intervals=Intervals(
                t_s=self.t_s[index],
                ranges=self.ranges[index],
                stds=self.stds[index],
                rss=self.rss[index],
                heard=self.heard[index],
                present=torch.ones(len(index), dtype=torch.bool),
            ),
            positions=self.positions[index],
        )
