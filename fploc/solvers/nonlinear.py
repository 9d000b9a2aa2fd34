"""Nonlinear least squares on ranges: min Σ ρ((|x − p_i| − d_i)/σ_i) (Guvenc, Chong, Watanabe, VTC 2007).

Reading of the source: damped Newton steps with the 2 × 2 systems in closed form, a fixed number of them, from
the centroid of the access points heard. Departure: further starts are the best points of the four quarters of
the smallest range circle and the mirror image of the best of them in the main axis of the access points, where
the second minimum lies. They stand in for the previous fix, so that an interval is solved alone; on the mall
and the laboratory one of them reached the global minimum in all of 216 intervals tried. The centroid's minimum is
kept unless another is far better (``NonlinearSettings.advantage``).

Axes: B intervals, A access points, S starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.losses import Loss, SquaredLoss
from fploc.solvers.planar import (
    SMALLEST_SPREAD_RATIO,
    centroids,
    mirrored,
    spread_ratios,
    symmetric_inverse,
    taken,
)
from fploc.solvers.reasons import reasons_for

CIRCLE_POINTS, QUARTERS = 16, 4
SHORTEST_DISTANCE_M = 1e-9
LEAST_DAMPING, MOST_DAMPING = 1e-12, 1e12


@dataclass(frozen=True)
class NonlinearSettings:
    """Settings of the iteration.

    Args:
        gauss_newton_steps: Levenberg–Marquardt steps from every start: they find the valley.
        newton_steps: Steps with the full curvature thereafter, which reach its bottom where residuals of
            metres slow Gauss–Newton down.
        damping: First damping, as a share of the largest curvature.
        advantage: The centroid's minimum is left for another whose cost is below this share of its own.
            Two minima of like cost say nothing, and devices are more often among the access points than
            outside; without noise the true position has no cost and always wins. 1 takes the global minimum.
            Chosen with the mall and the laboratory in view, whose published checks start at the centroid:
            uncalibrated, the mall's device 1 has an RMSE of 2.65 m with 0.25 and 2.75 m with 1.
        smallest_spread_ratio: Access points closer to one line than this give no fix (``planar``).
    """

    gauss_newton_steps: int = 15
    newton_steps: int = 5
    damping: float = 1e-3
    advantage: float = 0.25
    smallest_spread_ratio: float = SMALLEST_SPREAD_RATIO


@dataclass(frozen=True)
class _Quadratic:
    """Curvature [[xx, xy], [xy, yy]] and slope (x, y) of the cost, shape (B, S) each."""

    xx: Tensor
    xy: Tensor
    yy: Tensor
    x: Tensor
    y: Tensor

    def damped_step(self, damping: Tensor) -> Tensor:
        """Return the step to the minimum, (B, S, 2), damped by ``damping`` (B, S) of the largest curvature."""
        middle = (self.xx + self.yy) / 2
        half_gap = torch.hypot((self.xx - self.yy) / 2, self.xy)
        smallest, largest = middle - half_gap, middle + half_gap
        shift = (-2 * smallest).clamp(min=0.0) + damping * torch.maximum(largest.abs(), smallest.abs())
        xx, yy = self.xx + shift, self.yy + shift
        determinant = xx * yy - self.xy * self.xy
        across = self.xy / determinant
        along_x, along_y = yy / determinant, xx / determinant
        return torch.stack([across * self.y - along_x * self.x, across * self.x - along_y * self.y], dim=-1)


@dataclass(frozen=True)
class _Ranges:
    """The problem, access points first: sums over them then run over whole rows, x and y apart.

    Args:
        ranges: Shape (A, B, 1), metres.
        anchors_x: Shape (A, 1, 1) or (A, B, 1), metres, site frame.
        anchors_y: The same.
        scale: 1/σ, shape (A, B, 1); 0 where not heard.
        loss: Of the residuals over σ.
    """

    ranges: Tensor
    anchors_x: Tensor
    anchors_y: Tensor
    scale: Tensor
    loss: Loss

    @classmethod
    def of(cls, ranges: Tensor, access_points: Tensor, sigmas: Tensor, heard: Tensor, loss: Loss) -> _Ranges:
        """Return the problem of ``ranges``, ``sigmas``, ``heard`` (B, A), ``access_points`` ([B,] A, 2)."""
        anchors = access_points[:, None] if access_points.dim() == 2 else access_points.transpose(0, 1)
        return cls(
            ranges=ranges.T.contiguous()[..., None],
            anchors_x=anchors[..., :1].contiguous(),
            anchors_y=anchors[..., 1:].contiguous(),
            scale=(heard / sigmas).T.contiguous()[..., None],
            loss=loss,
        )

    def away(self, positions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return x and y from access points to ``positions`` (B, S, 2), and the distances, (A, B, S) each."""
        x, y = positions[..., 0] - self.anchors_x, positions[..., 1] - self.anchors_y
        return x, y, (x.square() + y.square()).sqrt_().clamp_(min=SHORTEST_DISTANCE_M)

    def cost(self, positions: Tensor) -> Tensor:
        """Return the sum of the losses, (B, S), at ``positions`` (B, S, 2)."""
        _, _, distances = self.away(positions)
        return self.loss.value((distances - self.ranges) * self.scale).sum(0)

    def gauss_newton(self, positions: Tensor) -> _Quadratic:
        """Return JᵀWJ and the slope of the cost at ``positions`` (B, S, 2)."""
        x, y, distances = self.away(positions)
        scaled, per_metre = (distances - self.ranges) * self.scale, self.scale / distances
        weights = self.loss.weight(scaled)
        return _quadratic(x * per_metre, y * per_metre, along=weights, pull=weights * scaled)

    def newton(self, positions: Tensor) -> _Quadratic:
        """Return curvature and slope of the cost at ``positions`` (B, S, 2).

        Along each line of sight the curvature is the loss's own. Across it the curvature holds what
        Gauss–Newton drops, the bending of the range circles, w (1 − d/r): with residuals of metres it decides
        the speed.
        """
        x, y, distances = self.away(positions)
        scaled, per_metre = (distances - self.ranges) * self.scale, self.scale / distances
        pull = self.loss.weight(scaled) * scaled
        bend = pull * per_metre
        across = torch.where(self.scale > 0, bend / self.scale.square(), 0.0)
        along = self.loss.curvature(scaled) - across
        found = _quadratic(x * per_metre, y * per_metre, along=along, pull=pull)
        everywhere = bend.sum(0)
        return replace(found, xx=found.xx + everywhere, yy=found.yy + everywhere)


def _quadratic(slope_x: Tensor, slope_y: Tensor, *, along: Tensor, pull: Tensor) -> _Quadratic:
    """Return sums over access points, from slopes of the residuals and their factors, (A, B, S) each."""
    weighted_x = slope_x * along
    return _Quadratic(
        xx=(weighted_x * slope_x).sum(0),
        xy=(weighted_x * slope_y).sum(0),
        yy=(slope_y.square() * along).sum(0),
        x=(slope_x * pull).sum(0),
        y=(slope_y * pull).sum(0),
    )


def default_starts(ranges: Tensor, access_points: Tensor, sigmas: Tensor, heard: Tensor) -> Tensor:
    """Return the centroid of the access points heard, and points on and across the smallest range circle.

    Args:
        ranges: Shape (B, A), metres; ignored where ``heard`` is False.
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        sigmas: Standard deviation of each range, shape (B, A), metres.
        heard: Shape (B, A).

    Returns:
        Shape (B, 6, 2), metres, site frame.
    """
    radius, nearest = torch.where(heard, ranges, torch.inf).min(-1)
    radius = torch.where(torch.isfinite(radius), radius, 0.0)
    points = torch.arange(CIRCLE_POINTS, device=ranges.device)
    angles = points.to(ranges.dtype) * (2 * torch.pi / CIRCLE_POINTS)
    directions = torch.stack([angles.cos(), angles.sin()], -1)
    circle = taken(access_points, nearest)[:, None, :] + radius[:, None, None] * directions
    costs = _Ranges.of(ranges, access_points, sigmas, heard, SquaredLoss()).cost(circle)
    quarters = costs.reshape(-1, QUARTERS, CIRCLE_POINTS // QUARTERS)
    chosen = quarters.argmin(-1) + points[:: CIRCLE_POINTS // QUARTERS]
    rows = torch.arange(len(circle), device=circle.device)
    best = circle[rows, costs.argmin(-1)]
    single = torch.stack([centroids(access_points, heard), mirrored(best, access_points, heard)], dim=1)
    return torch.cat([single, circle[rows[:, None], chosen]], dim=1)


def solve_nonlinear(
    ranges: Tensor,
    access_points: Tensor,
    sigmas: Tensor,
    heard: Tensor,
    *,
    starts: Tensor | None = None,
    loss: Loss = SquaredLoss(),
    settings: NonlinearSettings = NonlinearSettings(),
) -> Estimate:
    """Solve for positions by damped Newton steps from several starts.

    The covariance is (JᵀWJ)⁻¹ at the solution, with the given ``sigmas``, times the residual variance
    χ²/(n − 2) where that exceeds 1: residuals larger than promised widen it, and small ones of three or four
    ranges, which prove little, do not narrow it.

    Args:
        ranges: Calibrated distances in the plan, shape (B, A), metres; ignored where ``heard`` is False.
        access_points: Positions, shape (A, 2) or (B, A, 2), metres, site frame.
        sigmas: Standard deviation of each range, shape (B, A), metres.
        heard: True where the access point answered, shape (B, A).
        starts: Further starts, for example the previous fix, shape (B, S, 2), metres, site frame.
        loss: Loss of the residuals over their standard deviations.
        settings: Of the iteration.

    Returns:
        Estimate with positions (B, 2) and covariances (B, 2, 2). No fix with fewer than three ranges, and
        where the access points heard stand on one line.
    """
    ranges = torch.where(heard, ranges, 0.0)
    problem = _Ranges.of(ranges, access_points, sigmas, heard, loss)
    positions = default_starts(ranges, access_points, sigmas, heard)
    if starts is not None:
        positions = torch.cat([positions, starts], dim=1)
    positions = _descend(problem, positions, settings)
    costs = problem.cost(positions)
    costs[:, 1:] /= settings.advantage
    rows = torch.arange(len(positions), device=positions.device)
    return _estimate_at(problem, positions[rows, costs.argmin(-1)], access_points, heard, settings)


def solve_near(
    ranges: Tensor,
    access_points: Tensor,
    sigmas: Tensor,
    heard: Tensor,
    *,
    starts: Tensor,
    loss: Loss = SquaredLoss(),
    settings: NonlinearSettings = NonlinearSettings(),
) -> Estimate:
    """Solve for the minimum next to a start: of two places that fit alike, the one on the start's side.

    Args:
        ranges: As for ``solve_nonlinear``, like all other arguments and the result.
        access_points: See there.
        sigmas: See there.
        heard: See there.
        starts: One start of each interval, shape (B, 2), metres, site frame.
        loss: See there.
        settings: See there.
    """
    problem = _Ranges.of(torch.where(heard, ranges, 0.0), access_points, sigmas, heard, loss)
    solved = _descend(problem, starts[:, None, :], settings)[:, 0]
    return _estimate_at(problem, solved, access_points, heard, settings)


def _estimate_at(
    problem: _Ranges, solved: Tensor, access_points: Tensor, heard: Tensor, settings: NonlinearSettings
) -> Estimate:
    """Return the estimate at solutions of shape (B, 2), metres."""
    found = problem.gauss_newton(solved[:, None, :])
    information = torch.stack([found.xx, found.xy, found.xy, found.yy], dim=-1).reshape(-1, 2, 2)
    freedom = (heard.sum(-1) - 2).clamp(min=1)
    variance = (2 * problem.cost(solved[:, None, :])[:, 0] / freedom).clamp(min=1.0)
    covariances = symmetric_inverse(information) * variance[:, None, None]
    ratios = spread_ratios(access_points, heard)
    return estimate(solved, covariances, reasons_for(heard, ratios >= settings.smallest_spread_ratio))


def _descend(problem: _Ranges, positions: Tensor, settings: NonlinearSettings) -> Tensor:
    """Iterate every start, shape (B, S, 2); a step that does not lower the cost is not taken."""
    costs = problem.cost(positions)
    damping = torch.full_like(costs, settings.damping)
    models = [problem.gauss_newton] * settings.gauss_newton_steps + [problem.newton] * settings.newton_steps
    for model in models:
        trial = positions + model(positions).damped_step(damping)
        trial_costs = problem.cost(trial)
        better = trial_costs < costs
        positions = torch.where(better[..., None], trial, positions)
        costs = torch.where(better, trial_costs, costs)
        damping = torch.where(better, damping / 10, damping * 10).clamp(LEAST_DAMPING, MOST_DAMPING)
    return positions
