"""``cbt-wccg``: clustering-based trilateration with weighted concentric circle generation (Ma, Wu, Poslad,
Selviah, IEEE TMC 2022).

From the source: the systematic bias is removed (here by the calibration); around each access point concentric
circles stand in for the one that a wrong range would draw, so that there are intersections where single circles
have none or several; clustering finds the position among them; a Kalman filter follows. Reconstructed here: the
radii d + δ with weights exp(−δ²/(2σ²)); all intersections of circles of two access points, a point with the weight
w₁ w₂/√(r₁ r₂); from the centroid of the heaviest cell a few mean-shift steps to the weighted centroid. Without noise
the position comes back within decimetres, not exactly: circles with δ ≠ 0 cross unevenly around it.

Axes: B intervals, A access points, P points: intersections, two for every pair of circles.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.intervals import Estimate, Intervals, estimate
from fploc.sites.site import Site
from fploc.solvers.planar import SMALLEST_SPREAD_RATIO, spread_ratios
from fploc.solvers.reasons import FEWEST_RANGES, reasons_for

NAME = "cbt-wccg"
CELLS_APART = 1_000_003
"""Cells in a column of the plane, more than any range spans: tells columns apart in the key of a cell."""


@dataclass(frozen=True)
class CbtWccgSettings:
    """Settings of the circles and of their clusters: conf/method/cbt-wccg.yaml.

    Args:
        shifts_m: δ of the circles around each access point, metres.
        shift_sd_m: σ of the weights of δ, metres.
        cell_m: Side of the cells among which the heaviest is sought, metres.
        kernel_m: Standard deviation of the mean shift's Gaussian, metres.
        mean_shift_steps: How many.
        calibration: That it runs with unless asked.
    """

    shifts_m: tuple[float, ...]
    shift_sd_m: float
    cell_m: float
    kernel_m: float
    mean_shift_steps: int
    calibration: str

    @classmethod
    def read(cls) -> CbtWccgSettings:
        """Return the settings in conf/method/cbt-wccg.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")


class CbtWccg:
    """The method on every interval alone. Its state is the access points' positions, shape (A, 2), metres.

    The covariance is the spread of the cluster's points, and of a position within a cell.

    Args:
        settings: Of circles and clusters; None for those of conf/method/cbt-wccg.yaml.
    """

    name = NAME
    memoryless = True

    def __init__(self, settings: CbtWccgSettings | None = None) -> None:
        self.settings = CbtWccgSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """Chosen with the other settings."""
        return self.settings.calibration

    def init(self, site: Site, devices: int) -> Tensor:
        """Return the access points' positions; they serve any number of devices."""
        return torch.from_numpy(site.positions_m)

    def step(self, state: Tensor, intervals: Intervals) -> tuple[Tensor, Estimate]:
        """Locate every device from one interval; no fix where no circles cross."""
        heard = intervals.heard & intervals.present[:, None]
        is_spread = spread_ratios(state, heard) >= SMALLEST_SPREAD_RATIO
        if len(state) < FEWEST_RANGES:
            nowhere = torch.full((len(heard), 2), torch.nan, dtype=state.dtype)
            return state, estimate(
                nowhere, nowhere[..., None].expand(-1, -1, 2), reasons_for(heard, is_spread)
            )
        points, weights = self._intersections(intervals.ranges.double(), state, heard)
        centres = heaviest_cells(points, weights, self.settings.cell_m)
        for _ in range(self.settings.mean_shift_steps):
            pulls = weights * self._kernel(points - centres[:, None])
            centres = (pulls[..., None] * points).sum(1) / pulls.sum(1, keepdim=True)
        away = points - centres[:, None]
        pulls = weights * self._kernel(away)
        spread = (pulls[..., None] * away).mT @ away / pulls.sum(1)[:, None, None]
        within_cell = self.settings.cell_m**2 / 12 * torch.eye(2, dtype=spread.dtype)
        reasons = reasons_for(heard, is_spread & (weights > 0).any(1))
        return state, estimate(centres, spread + within_cell, reasons)

    def _kernel(self, away: Tensor) -> Tensor:
        """Return the Gaussian of vectors of shape (B, P, 2), metres."""
        return torch.exp(-away.square().sum(-1) / (2 * self.settings.kernel_m**2))

    def _intersections(self, ranges: Tensor, access_points: Tensor, heard: Tensor) -> tuple[Tensor, Tensor]:
        """Return points (B, P, 2), metres, and their weights (B, P); 0 where circles do not cross."""
        shifts = torch.tensor(self.settings.shifts_m, dtype=ranges.dtype)
        shift_weights = torch.exp(-shifts.square() / (2 * self.settings.shift_sd_m**2))
        one, two = torch.combinations(torch.arange(len(access_points))).T
        line = access_points[two] - access_points[one]
        distance = line.norm(dim=-1)[:, None, None]
        ahead = (line / line.norm(dim=-1, keepdim=True))[:, None, None, :]
        aside = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
        radii = ranges[..., None] + shifts
        first, second = radii[:, one, :, None], radii[:, two, None, :]
        along = (first.square() - second.square() + distance.square()) / (2 * distance)
        squared_height = first.square() - along.square()
        crosses = (squared_height >= 0) & (first > 0) & (second > 0) & (distance > 0)
        crosses = crosses & (heard[:, one] & heard[:, two])[:, :, None, None]
        height = squared_height.clamp(min=0.0).sqrt()
        feet = access_points[one][:, None, None, :] + along[..., None] * ahead
        points = torch.stack([feet + height[..., None] * aside, feet - height[..., None] * aside], -2)
        points = torch.where(crosses[..., None, None], points, 0.0)
        pair_weights = shift_weights[:, None] * shift_weights / (first * second).clamp(min=1e-12).sqrt()
        weights = torch.where(crosses, pair_weights, 0.0)[..., None].expand(points.shape[:-1])
        return points.flatten(1, -2), weights.flatten(1)


def heaviest_cells(points: Tensor, weights: Tensor, cell_m: float) -> Tensor:
    """Return the weighted centroid of the points in the heaviest cell of each row.

    Args:
        points: Shape (B, P, 2), metres.
        weights: Shape (B, P).
        cell_m: Side of a cell, metres.

    Returns:
        Shape (B, 2), metres; NaN where every weight is 0.
    """
    cells = (points / cell_m).floor().long()
    keys, order = (cells[..., 0] * CELLS_APART + cells[..., 1]).sort(dim=1, stable=True)
    sums = weights.gather(1, order).cumsum(1)
    is_last = torch.ones_like(keys, dtype=torch.bool)
    is_last[:, :-1] = keys[:, 1:] != keys[:, :-1]
    ends = torch.where(is_last, sums, 0.0)
    before = torch.nn.functional.pad(ends.cummax(1).values[:, :-1], (1, 0))
    heaviest = torch.where(is_last, ends - before, -1.0).argmax(1, keepdim=True)
    inside = torch.where(
        cells[..., 0] * CELLS_APART + cells[..., 1] == keys.gather(1, heaviest), weights, 0.0
    )
    return (inside[..., None] * points).sum(1) / inside.sum(1, keepdim=True)
