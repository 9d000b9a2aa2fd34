"""``gnn-fpdnn``: the paper's chain from readings to a position."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.filters.kalman import BatchedFilter, KalmanSettings, KalmanState
from fploc.floorplan.raster import CropSettings, PlanRaster
from fploc.intervals import Estimate, Intervals, links_of, selected
from fploc.methods.chained import Companion
from fploc.methods.gnn import GNNMethod
from fploc.methods.one_shot import RangeSolver
from fploc.models.fpdnn import FPDNN, Sight
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site
from fploc.solvers.losses import Loss
from fploc.solvers.nonlinear import solve_near
from fploc.solvers.reasons import FEWEST_RANGES

CROP_PIXELS_AT_ONCE = 8_000_000


@dataclass(frozen=True)
class ChainState:
    """Access points, shape (A, 2), metres, and the tracks of the coarse positions."""

    access_points: Tensor
    coarse: KalmanState


class GNNFPDNN:
    """GNN → Kalman filter → crops → FPDNN → least squares (paper, "Framework of Localization System").

    The Kalman filter smooths the coarse positions before they are used for cropping; the one behind the
    final positions is the localizer's.

    Args:
        coarse: The GNN as a method.
        network: The trained FPDNN, in evaluation mode.
        plan: Plan that crops are taken from.
        crops: How they are taken.
        solver: From corrected ranges to a position; the paper's is linear.
        sigma_m: Standard deviation of a corrected range, metres, from the validation recordings.
        filter_settings: Of the filter on coarse positions.
        sight: What FPDNN is given of the plan.
    """

    name = "gnn-fpdnn"

    def __init__(
        self,
        coarse: GNNMethod,
        network: FPDNN,
        plan: PlanRaster,
        crops: CropSettings,
        solver: RangeSolver,
        sigma_m: float,
        filter_settings: KalmanSettings,
        sight: Sight = Sight.PLAN,
    ) -> None:
        self.coarse = coarse
        self.network = network
        self.plan = crops.softened(plan)
        self.crops = crops
        self.solver = solver
        self.sigma_m = sigma_m
        self.filter = BatchedFilter(filter_settings)
        self.sight = sight

    def init(self, site: Site, devices: int) -> ChainState:
        """Return the state of ``devices`` devices before their first interval."""
        return ChainState(access_points=self.coarse.init(site, devices), coarse=self.filter.init(devices))

    def step(self, state: ChainState, intervals: Intervals) -> tuple[ChainState, Estimate]:
        """Locate every device from one interval."""
        _, found = self.coarse.step(state.access_points, intervals)
        tracks, filtered = self.filter.step(state.coarse, intervals.t_s, intervals.present, found)
        return ChainState(state.access_points, tracks), self.refine(state.access_points, intervals, filtered)

    def rows_at_once(self, access_points: int) -> int:
        """Return how many rows of ``access_points`` links have crops of 8 million pixels together, at least 1."""
        return max(1, CROP_PIXELS_AT_ONCE // (self.crops.largest_px * access_points))

    @torch.no_grad()
    def refine(self, access_points: Tensor, intervals: Intervals, coarse: Estimate) -> Estimate:
        """Locate every device from one interval and its filtered coarse position, each row alone.

        Ranges beyond 60 m count as not heard.
        """
        intervals = intervals.nearer_than(FARTHEST_RANGE_M)
        corrected = self.corrected_ranges(intervals, access_points, coarse)
        sigmas = torch.full_like(corrected, self.sigma_m)
        return self.solver(corrected, access_points.double(), sigmas, intervals.heard)

    @torch.no_grad()
    def refine_beside(
        self,
        access_points: Tensor,
        intervals: Intervals,
        coarse: Estimate,
        companion: Companion,
        *,
        loss: Loss,
    ) -> Estimate:
        """Locate every device as ``refine`` does, with the other device as one more access point.

        With two access points it is the third. Two places fit three ranges about equally well where the
        three stand nearly on one line: the one next to the filtered coarse position is taken.

        Args:
            access_points: Shape (A, 2), metres, site frame.
            intervals: Of one device each.
            coarse: Smoothed coarse positions.
            companion: The other device of each.
            loss: Of ranges where fewer than three access points are heard.
        """
        intervals = intervals.nearer_than(FARTHEST_RANGE_M)
        corrected = self.corrected_ranges(intervals, access_points, coarse)
        sigmas = companion.behind(torch.full_like(corrected, self.sigma_m), companion.sigmas)
        ranges = companion.behind(corrected, companion.ranges)
        anchors, heard = companion.anchors(access_points), companion.behind(intervals.heard, companion.there)
        joint = self.solver(ranges, anchors, sigmas, heard)
        starts = torch.where(coarse.fixed[:, None], coarse.positions, 0.0)
        near = solve_near(ranges, anchors, sigmas, heard, starts=starts, loss=loss)
        return selected(coarse.fixed & (intervals.heard.sum(-1) < FEWEST_RANGES), near, joint)

    def corrected_ranges(self, intervals: Intervals, access_points: Tensor, coarse: Estimate) -> Tensor:
        """Return ζ̂ of every link, shape (B, A), metres; devices without a coarse position keep ζ."""
        corrected = intervals.ranges.double()
        links = links_of(intervals, access_points)
        seen = coarse.fixed[links.device]
        device, starts = links.device[seen], links.access_points[seen]
        if len(device) == 0:
            return corrected
        crops = self.crops.crop_softened(self.plan, starts, coarse.positions[device].float())
        ranges, rss = links.ranges[seen].float(), links.rss[seen].float()
        sight = torch.full_like(device, self.sight)
        estimated = self.network(crops.images, crops.lengths_px, ranges, rss, sight)
        chosen = intervals.heard & coarse.fixed[:, None]
        return corrected.masked_scatter(chosen, estimated.double())
