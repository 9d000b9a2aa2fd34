"""Linear least squares on ranges with a reference access point (Guvenc, Gezici, Watanabe, Inamura, WCNC 2008).

Subtracting the squared range equation of a reference r from that of every other access point i gives rows
2 (p_i − p_r)·x = d_r² − d_i² + |p_i|² − |p_r|². ``LLS-RS`` takes r = argmin d_i; ``WLLS`` weighs the rows by the
inverse of their covariance, which the reference makes correlated.

Two guards, since the system explodes on near-singular rows and on range outliers: access points that stand
nearly on one line give no fix, and neither does a solution farther from the reference than its range allows.

Axes: B intervals, A access points.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.planar import SMALLEST_SPREAD_RATIO, spread_ratios, symmetric_inverse, taken
from fploc.solvers.reasons import reasons_for


@dataclass(frozen=True)
class LinearSettings:
    """Guards of the linear solvers.

    Args:
        smallest_spread_ratio: Access points closer to one line than this give no fix (``planar``).
        reach_m: A solution is refused where its distance to the reference exceeds the reference's range by
            more than this, metres: no position can be that far from an access point it is near to.
    """

    smallest_spread_ratio: float = SMALLEST_SPREAD_RATIO
    reach_m: float = 10.0


def nearest_access_points(ranges: Tensor, heard: Tensor) -> Tensor:
    """Return the index of the smallest range heard, shape (B,); 0 where nothing is heard."""
    return torch.where(heard, ranges, torch.inf).argmin(-1)


def solve_linear(
    ranges: Tensor,
    access_points: Tensor,
    sigmas: Tensor,
    heard: Tensor,
    *,
    reference: Tensor | None = None,
    settings: LinearSettings = LinearSettings(),
) -> Estimate:
    """Solve the unweighted linear system against a reference access point.

    The covariance carries the range variances through the solution: with G = (MᵀM)⁻¹Mᵀ it is G C Gᵀ, C as in
    ``solve_weighted_linear``.

    Args:
        ranges: Calibrated distances in the plan, shape (B, A), metres; ignored where ``heard`` is False.
        access_points: Positions, shape (A, 2) or (B, A, 2), metres, site frame.
        sigmas: Standard deviation of each range, shape (B, A), metres.
        heard: True where the access point answered, shape (B, A).
        reference: Index of each row's reference, shape (B,), which must be heard; None for the nearest.
        settings: Guards.

    Returns:
        Estimate with positions (B, 2) and covariances (B, 2, 2). No fix with fewer than three ranges, with
        access points on one line, and where the solution is out of the reference's reach.
    """
    system = _System.of(ranges, access_points, heard, reference)
    arms, used = system.arms, system.used
    gain = symmetric_inverse(4 * arms.mT @ arms) @ (2 * arms.mT)
    variances = variances_of_squares(ranges, sigmas)
    own = torch.where(used, variances, 0.0)
    shared = variances.gather(1, system.index)
    summed = (gain * used[:, None, :]).sum(-1)
    covariances = (gain * own[:, None, :]) @ gain.mT
    covariances = covariances + shared[..., None] * summed[..., None] * summed[:, None, :]
    return _guarded(system, (gain @ system.right[..., None])[..., 0], covariances, settings)


def solve_weighted_linear(
    ranges: Tensor,
    access_points: Tensor,
    sigmas: Tensor,
    heard: Tensor,
    *,
    settings: LinearSettings = LinearSettings(),
) -> Estimate:
    """Solve the linear system against the nearest access point, its rows weighted by C⁻¹.

    C_ij = 4 d_r² σ_r² + 2 σ_r⁴ + [i = j] (4 d_i² σ_i² + 2 σ_i⁴), a diagonal and a constant, whose inverse is
    known. The covariance is (MᵀC⁻¹M)⁻¹.

    Args:
        ranges: As for ``solve_linear``, like all other arguments.
        access_points: See there.
        sigmas: See there.
        heard: See there.
        settings: Guards.

    Returns:
        As ``solve_linear`` does, with the same reasons for no fix.
    """
    system = _System.of(ranges, access_points, heard, None)
    rows = 2 * system.arms
    own = variances_of_squares(ranges, sigmas)
    shared = own.gather(1, system.index)
    weights = torch.where(system.used, 1 / own, 0.0)
    together = (weights[..., None] * rows).sum(1)
    share = shared / (1 + shared * weights.sum(-1, keepdim=True))
    weighted = weights[..., None] * rows - (share * weights)[..., None] * together[:, None, :]
    covariances = symmetric_inverse(weighted.mT @ rows)
    away = (covariances @ (weighted.mT @ system.right[..., None]))[..., 0]
    return _guarded(system, away, covariances, settings)


def variances_of_squares(ranges: Tensor, sigmas: Tensor) -> Tensor:
    """Return the variances of normal d², 4 d² σ² + 2 σ⁴, in metres to the fourth: above 0 at a range of 0 as well."""
    return 4 * (ranges * sigmas).square() + 2 * sigmas.pow(4)


@dataclass(frozen=True)
class _System:
    """Rows of the linear system of every interval.

    Args:
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        heard: Shape (B, A).
        index: Of the reference, shape (B, 1).
        origin: Position of the reference, shape (B, 2), metres, site frame.
        reference_range: Shape (B, 1), metres.
        used: True where an access point makes a row, shape (B, A).
        arms: p_i − p_r, shape (B, A, 2), metres; 0 where there is no row.
        right: d_r² − d_i² + |p_i − p_r|², shape (B, A), square metres; 0 where there is no row.
    """

    access_points: Tensor
    heard: Tensor
    index: Tensor
    origin: Tensor
    reference_range: Tensor
    used: Tensor
    arms: Tensor
    right: Tensor

    @classmethod
    def of(cls, ranges: Tensor, access_points: Tensor, heard: Tensor, reference: Tensor | None) -> _System:
        """Return the system against each row's reference; None for the nearest access point."""
        chosen = nearest_access_points(ranges, heard) if reference is None else reference
        index = chosen[:, None]
        origin = taken(access_points, chosen)
        reference_range = ranges.gather(1, index)
        used = heard.scatter(1, index, False)
        arms = torch.where(used[..., None], access_points - origin[:, None, :], 0.0)
        right = torch.where(used, reference_range.square() - ranges.square() + arms.square().sum(-1), 0.0)
        return cls(access_points, heard, index, origin, reference_range, used, arms, right)


def _guarded(system: _System, away: Tensor, covariances: Tensor, settings: LinearSettings) -> Estimate:
    """Return the estimate ``away`` from the reference, shape (B, 2), without what the guards refuse."""
    is_spread = spread_ratios(system.access_points, system.heard) >= settings.smallest_spread_ratio
    is_within = away.norm(dim=-1) <= system.reference_range[:, 0] + settings.reach_m
    return estimate(system.origin + away, covariances, reasons_for(system.heard, is_spread & is_within))
