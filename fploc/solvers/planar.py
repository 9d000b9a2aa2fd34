"""Closed forms in the plane that all solvers share: 2 × 2 matrices, and how access points spread.

Axes: B intervals, A access points. Positions of access points may be those of a site, shape (A, 2), or each
interval's own, shape (B, A, 2): then another device whose range is known can be one of them.
"""

from __future__ import annotations

import torch
from torch import Tensor

SMALLEST_SPREAD_RATIO = 0.01
"""Access points whose spread across their main axis is less than this share of the spread along it stand on
one line: ranges then fix a position and its mirror image equally well. 1 % is 0.3 m on 30 m."""


def symmetric_inverse(matrices: Tensor) -> Tensor:
    """Invert symmetric 2 × 2 matrices by the closed form; singular ones become infinite or NaN.

    Args:
        matrices: Shape (…, 2, 2).

    Returns:
        Shape (…, 2, 2).
    """
    a, b, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    adjugate = torch.stack([torch.stack([d, -b], -1), torch.stack([-b, a], -1)], -2)
    return adjugate / (a * d - b * b)[..., None, None]


def eigenvalues(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Return the smaller and the larger eigenvalue of symmetric 2 × 2 matrices, shape (…,) each."""
    a, b, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    middle, half_gap = (a + d) / 2, torch.hypot((a - d) / 2, b)
    return middle - half_gap, middle + half_gap


def taken(access_points: Tensor, index: Tensor) -> Tensor:
    """Return the positions of chosen access points.

    Args:
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        index: Of the access points of each interval, shape (B, …), int64.

    Returns:
        Shape (B, …, 2), metres, site frame.
    """
    if access_points.dim() == 2:
        return access_points[index]
    rows = torch.arange(len(index), device=index.device)
    return access_points[rows.reshape(-1, *[1] * (index.dim() - 1)), index]


def centroids(access_points: Tensor, heard: Tensor) -> Tensor:
    """Return the mean of the access points heard.

    Args:
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        heard: Shape (B, A).

    Returns:
        Shape (B, 2), metres, site frame; the origin where nothing is heard.
    """
    weights = heard.to(access_points.dtype)
    summed = (weights[:, None, :] @ access_points)[:, 0]
    return summed / weights.sum(-1, keepdim=True).clamp(min=1.0)


def spread_ratios(access_points: Tensor, heard: Tensor) -> Tensor:
    """Return how far the access points heard are from standing on one line.

    Args:
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        heard: Shape (B, A).

    Returns:
        Standard deviation across the main axis over the one along it, shape (B,), in 0…1; 0 on a line, at
        one point, and with fewer than three access points.
    """
    offsets = access_points - centroids(access_points, heard)[:, None, :]
    offsets = offsets * heard[..., None]
    small, large = eigenvalues(offsets.mT @ offsets)
    return (small.clamp(min=0.0) / large.clamp(min=torch.finfo(large.dtype).tiny)).sqrt()


def mirrored(points: Tensor, access_points: Tensor, heard: Tensor) -> Tensor:
    """Reflect points in the main axis of the access points heard: where the second minimum is to be sought.

    Args:
        points: Shape (B, 2), metres, site frame.
        access_points: Shape (A, 2) or (B, A, 2), metres, site frame.
        heard: Shape (B, A).

    Returns:
        Shape (B, 2), metres, site frame.
    """
    centre = centroids(access_points, heard)
    offsets = (access_points - centre[:, None, :]) * heard[..., None]
    scatter = offsets.mT @ offsets
    angle = torch.atan2(2 * scatter[:, 0, 1], scatter[:, 0, 0] - scatter[:, 1, 1]) / 2
    axis = torch.stack([angle.cos(), angle.sin()], -1)
    away = points - centre
    return centre + 2 * (away * axis).sum(-1, keepdim=True) * axis - away
