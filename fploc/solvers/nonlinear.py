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

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.losses import Loss, SquaredLoss
from fploc.solvers.planar import (
    SMALLEST_SPREAD_RATIO,
    centroids,
    eigenvalues,
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
class _Ranges:
    """The problem: ``ranges``, ``sigmas``, ``heard`` (B, A), ``access_points`` (A, 2) or (B, A, 2), ``loss``."""

    ranges: Tensor
    access_points: Tensor
    sigmas: Tensor
    heard: Tensor
    loss: Loss

    def away(self, positions: Tensor) -> Tensor:
        """Return the vectors from access points to ``positions`` (B, S, 2), shape (B, S, A, 2)."""
        anchors = self.access_points if self.access_points.dim() == 2 else self.access_points[:, None]
        return positions[..., None, :] - anchors

    def scaled_residuals(self, positions: Tensor) -> tuple[Tensor, Tensor]:
        """Return residuals over σ, (B, S, A), and their Jacobian, (B, S, A, 2), at ``positions`` (B, S, 2)."""
        away = self.away(positions)
        distances = away.square().sum(-1).sqrt().clamp(min=SHORTEST_DISTANCE_M)
        scale = (self.heard / self.sigmas)[:, None, :]
        return (distances - self.ranges[:, None, :]) * scale, away * (scale / distances)[..., None]

    def cost(self, positions: Tensor) -> Tensor:
        """Return the sum of the losses, (B, S), at ``positions`` (B, S, 2)."""
        return self.loss.value(self.scaled_residuals(positions)[0]).sum(-1)

    def gauss_newton_equations(self, positions: Tensor) -> tuple[Tensor, Tensor]:
        """Return JᵀWJ, shape (B, S, 2, 2), and the slope of the cost, (B, S, 2)."""
        scaled, jacobian = self.scaled_residuals(positions)
        weighted = jacobian * self.loss.weight(scaled)[..., None]
        return weighted.mT @ jacobian, (weighted * scaled[..., None]).sum(-2)

    def newton_equations(self, positions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the curvature of the cost, (B, S, 2, 2), and its slope, (B, S, 2).

        Along each line of sight the curvature is the loss's own. Across it the curvature holds what
        Gauss–Newton drops, the bending of the range circles, w (1 − d/r): with residuals of metres it decides
        the speed.
        """
        scaled, jacobian = self.scaled_residuals(positions)
        weights = self.loss.weight(scaled)
        scale = (self.heard / self.sigmas)[:, None, :]
        distances = self.away(positions).square().sum(-1).sqrt()
        bend = weights * scale * scaled / distances.clamp(min=SHORTEST_DISTANCE_M)
        across = torch.where(scale > 0, bend / scale.square(), 0.0)[..., None]
        identity = torch.eye(2, dtype=positions.dtype, device=positions.device)
        along = self.loss.curvature(scaled)[..., None]
        curvature = (jacobian * (along - across)).mT @ jacobian
        curvature = curvature + bend.sum(-1)[..., None, None] * identity
        return curvature, (jacobian * (weights * scaled)[..., None]).sum(-2)


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
    costs = _Ranges(ranges, access_points, sigmas, heard, SquaredLoss()).cost(circle)
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
    problem = _Ranges(torch.where(heard, ranges, 0.0), access_points, sigmas, heard, loss)
    positions = default_starts(problem.ranges, access_points, sigmas, heard)
    if starts is not None:
        positions = torch.cat([positions, starts], dim=1)
    positions = _descend(problem, positions, settings)
    costs = problem.cost(positions)
    costs[:, 1:] /= settings.advantage
    rows = torch.arange(len(positions), device=positions.device)
    return _estimate_at(problem, positions[rows, costs.argmin(-1)], settings)


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
    problem = _Ranges(torch.where(heard, ranges, 0.0), access_points, sigmas, heard, loss)
    return _estimate_at(problem, _descend(problem, starts[:, None, :], settings)[:, 0], settings)


def _estimate_at(problem: _Ranges, solved: Tensor, settings: NonlinearSettings) -> Estimate:
    """Return the estimate at solutions of shape (B, 2), metres."""
    information, _ = problem.gauss_newton_equations(solved[:, None, :])
    scaled, _ = problem.scaled_residuals(solved[:, None, :])
    freedom = (problem.heard.sum(-1) - 2).clamp(min=1)
    variance = (2 * problem.loss.value(scaled).sum(-1)[:, 0] / freedom).clamp(min=1.0)
    covariances = symmetric_inverse(information[:, 0]) * variance[:, None, None]
    ratios = spread_ratios(problem.access_points, problem.heard)
    return estimate(solved, covariances, reasons_for(problem.heard, ratios >= settings.smallest_spread_ratio))


def _descend(problem: _Ranges, positions: Tensor, settings: NonlinearSettings) -> Tensor:
    """Iterate every start, shape (B, S, 2); a step that does not lower the cost is not taken."""
    costs = problem.cost(positions)
    damping = torch.full_like(costs, settings.damping)
    identity = torch.eye(2, dtype=positions.dtype, device=positions.device)
    systems = [problem.gauss_newton_equations] * settings.gauss_newton_steps
    for equations in systems + [problem.newton_equations] * settings.newton_steps:
        curvature, slope = equations(positions)
        smallest, largest = eigenvalues(curvature)
        shift = (-2 * smallest).clamp(min=0.0) + damping * torch.maximum(largest.abs(), smallest.abs())
        damped = curvature + shift[..., None, None] * identity
        trial = positions - (symmetric_inverse(damped) @ slope[..., None])[..., 0]
        trial_costs = problem.cost(trial)
        better = trial_costs < costs
        positions = torch.where(better[..., None], trial, positions)
        costs = torch.where(better, trial_costs, costs)
        damping = torch.where(better, damping / 10, damping * 10).clamp(LEAST_DAMPING, MOST_DAMPING)
    return positions
