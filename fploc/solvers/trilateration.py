"""Trilateration on the three nearest access points (the paper, commented text).

The nearest access point is the reference of a linear system with two others: the two with the next smallest
ranges, unless their directions from the reference are nearly parallel, when farther ones are swapped in.

Axes: B intervals, A access points.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.linear import LinearSettings, solve_linear
from fploc.solvers.planar import taken
from fploc.solvers.reasons import FEWEST_RANGES, reasons_for


@dataclass(frozen=True)
class TrilaterationSettings:
    """Guards of trilateration.

    Args:
        smallest_sine: Two access points whose directions from the reference meet at a sine below this
            are near singular together; 0.1 is 6°.
        reach_m: As in ``LinearSettings``.
    """

    smallest_sine: float = 0.1
    reach_m: float = LinearSettings.reach_m


def solve_trilateration(
    ranges: Tensor,
    access_points: Tensor,
    sigmas: Tensor,
    heard: Tensor,
    *,
    settings: TrilaterationSettings = TrilaterationSettings(),
) -> Estimate:
    """Solve for positions from three ranges.

    Args:
        ranges: Calibrated distances in the plan, shape (B, A), metres; ignored where ``heard`` is False.
        access_points: Positions, shape (A, 2) or (B, A, 2), metres, site frame.
        sigmas: Standard deviation of each range, shape (B, A), metres.
        heard: True where the access point answered, shape (B, A).
        settings: Guards.

    Returns:
        Estimate with positions (B, 2) and covariances (B, 2, 2), which carry the range variances through the
        solution. No fix with fewer than three ranges, where every choice of access points is near singular,
        and where the solution is out of the reference's reach.
    """
    if access_points.shape[-2] < FEWEST_RANGES:
        nowhere = torch.full((len(ranges), 2), torch.nan, dtype=ranges.dtype, device=ranges.device)
        no_spread = nowhere[:, :, None].expand(-1, -1, 2)
        return estimate(nowhere, no_spread, reasons_for(heard, torch.zeros_like(heard[:, :1])[:, 0]))
    order = torch.where(heard, ranges, torch.inf).argsort(stable=True, dim=-1)
    chosen, is_regular = _choose(order, access_points, heard, settings.smallest_sine)
    three = torch.zeros_like(heard).scatter(1, chosen, True) & heard
    guards = LinearSettings(smallest_spread_ratio=0.0, reach_m=settings.reach_m)
    solved = solve_linear(ranges, access_points, sigmas, three, reference=order[:, 0], settings=guards)
    return estimate(solved.positions, solved.covariances, reasons_for(heard, is_regular & solved.fixed))


def _choose(
    order: Tensor, access_points: Tensor, heard: Tensor, smallest_sine: float
) -> tuple[Tensor, Tensor]:
    """Return the three access points of each row, (B, 3), and whether they fix a position, (B,).

    Pairs beside the nearest access point are tried by the rank of their farther member, then of the nearer.
    """
    ranks = torch.arange(1, order.shape[1], device=order.device)
    nearer, farther = torch.meshgrid(ranks, ranks, indexing="xy")
    pairs = torch.stack([nearer, farther], -1)[nearer < farther]
    members = order[:, pairs]
    arms = taken(access_points, members) - taken(access_points, order[:, 0])[:, None, None, :]
    one, two = arms[..., 0, :], arms[..., 1, :]
    cross = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    is_wide = cross.abs() > smallest_sine * one.norm(dim=-1) * two.norm(dim=-1)
    is_heard = heard[torch.arange(len(order), device=order.device)[:, None, None], members].all(-1)
    is_regular = is_wide & is_heard
    first = is_regular.to(torch.uint8).argmax(-1)
    pair = members[torch.arange(len(order), device=order.device), first]
    return torch.cat([order[:, :1], pair], dim=1), is_regular.any(-1)
