"""The offset of the link between two devices, learned from the stream alone.

No source has a log of such a link, so that its offset cannot be fitted before. It is a state: a belief over
offsets b that begins as the Gaussian around the access points' offset and is multiplied, at each reading of the
link at which both devices have fixes of their own, by how well b explains it. With the error e = range −
|x₁ − x₂| of a reading, and s² = spread² + uᵀ(P₁ + P₂)u, where u points from one device to the other, the factor is

    exp(−√2 |e − b| / s) to the power min(1, Δt / correlation).

The Laplace density makes the belief's centre a running, weighted median, which readings through walls move little.
The power counts readings by the time between them, since errors of fixes last. Only the past and the devices' own
fixes enter: no label, and no statistic over a recording.

Axes: R readings in order of time, G offsets of the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fploc.datasets.recordings import Bools, Floats


@dataclass(frozen=True)
class LinkOffsetSettings:
    """Settings of the belief: conf/link/device-link.yaml.

    Args:
        prior_sd_m: Standard deviation of the offset around the access points', metres.
        spread_m: Standard deviation of a range between devices, metres.
        correlation_s: For so long the errors of fixes, and of ranges between devices, are one error, seconds.
        nearest_m: Devices whose fixes are nearer to each other than this say nothing: errors of fixes then
            lengthen their distance, metres.
        reach_m: Of the grid to both sides of the prior, metres.
        step_m: Of the grid, metres.
    """

    prior_sd_m: float
    spread_m: float
    correlation_s: float
    nearest_m: float
    reach_m: float
    step_m: float


@dataclass(frozen=True)
class LinkOffsets:
    """What is known of the offset before any reading and after each.

    Args:
        means_m: Shape (R + 1,), metres; the first is the prior's.
        sds_m: Standard deviations, shape (R + 1,), metres.
    """

    means_m: Floats
    sds_m: Floats


def running_link_offsets(
    t_s: Floats,
    ranges_m: Floats,
    positions_m: tuple[Floats, Floats],
    covariances_m2: tuple[Floats, Floats],
    usable: Bools,
    *,
    prior_m: float,
    settings: LinkOffsetSettings,
) -> LinkOffsets:
    """Return the offset of a link as the readings up to each know it.

    Args:
        t_s: Time of each reading, in order, shape (R,), seconds.
        ranges_m: As measured, shape (R,), metres.
        positions_m: Of device 1 and of device 2 at each reading, shape (R, 2) each, metres, site frame.
        covariances_m2: Of these, shape (R, 2, 2) each, square metres.
        usable: True where both are fixes of the devices' own, shape (R,).
        prior_m: Offset of ranges to access points, metres.
        settings: Of the belief.
    """
    offsets = prior_m + np.arange(-settings.reach_m, settings.reach_m + settings.step_m / 2, settings.step_m)
    away = np.where(usable[:, None], positions_m[0] - positions_m[1], 0.0)
    distances = np.linalg.norm(away, axis=1)
    counts = usable & (distances >= settings.nearest_m)
    directions = away / np.maximum(distances, settings.nearest_m)[:, None]
    summed = np.where(counts[:, None, None], covariances_m2[0] + covariances_m2[1], 0.0)
    along = np.einsum("ri,rij,rj->r", directions, summed, directions)
    spreads = np.sqrt(settings.spread_m**2 + along)
    misfits = np.abs((ranges_m - distances)[:, None] - offsets) * (np.sqrt(2) / spreads)[:, None]
    powers = _powers(t_s, counts, settings.correlation_s)
    prior = -0.5 * ((offsets - prior_m) / settings.prior_sd_m) ** 2
    logarithms = np.cumsum(np.vstack([prior, -misfits * powers[:, None]]), axis=0)
    beliefs = np.exp(logarithms - logarithms.max(axis=1, keepdims=True))
    beliefs /= beliefs.sum(axis=1, keepdims=True)
    means: NDArray[np.float64] = beliefs @ offsets
    variances = np.einsum("rg,rg->r", beliefs, (offsets - means[:, None]) ** 2)
    return LinkOffsets(means, np.sqrt(variances))


def _powers(t_s: Floats, counts: Bools, correlation_s: float) -> Floats:
    """Return the power that each reading's factor is raised to, shape (R,); 0 where it does not count."""
    times = t_s[counts]
    since_s = np.diff(times, prepend=times[:1] - correlation_s)
    powers = np.zeros(len(t_s))
    powers[counts] = np.minimum(1.0, since_s / correlation_s)
    return powers
