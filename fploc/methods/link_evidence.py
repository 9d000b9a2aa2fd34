"""What every link of a device says of its own range.

Axes: B devices, A access points, W windows, F features.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Intervals
from fploc.plausible import FARTHEST_RANGE_M

WINDOWS_S = (2.0, 10.0)
"""Time constants of a link's recent past: a few steps, and the stretch over which errors of places last."""
LONGEST_SILENCE_S = 30.0
FEATURES = (
    "range",
    "range against what the others say",
    "range against what all say",
    "spread of what the others say",
    "the same residual, 10 s mean",
    "the same residual, 10 s restlessness",
    "range, 2 s restlessness",
    "range, 10 s restlessness",
    "loss rate",
    "signal strength",
)
"""Names of the axis F. Signal strengths are those received: taken against the phone's own, they say less."""
SIGHTS = 2
"""Whether walls stand between: not at all, or some."""


@dataclass(frozen=True)
class View:
    """What a network is shown of a link.

    Args:
        features: Of ``FEATURES``, as indices of the axis F.
        sights: ``SIGHTS`` where it is told whether walls stand between, 1 where not.
    """

    features: tuple[int, ...]
    sights: int


IN_CONTEXT = View(tuple(range(9)), SIGHTS)
BY_ITS_PAST = View((0, 6, 7, 8, 9), SIGHTS)
BY_STRENGTH = View((0, 9), SIGHTS)
ALONE = View((0, 9), 1)
VIEWS = (IN_CONTEXT, BY_ITS_PAST, BY_STRENGTH, ALONE)
"""Beside all other links and its own past, as if it were the only one, at this moment, and wherever one may be."""


@dataclass(frozen=True)
class RangeExpectation:
    """What a belief expects of the ranges of an interval, each shape (B, A), metres.

    Args:
        by_others: Mean distance, by all ranges but this one.
        spread: Standard deviation of that distance.
        by_all: Mean distance, by all ranges.
    """

    by_others: Tensor
    spread: Tensor
    by_all: Tensor


@dataclass(frozen=True)
class Followed:
    """Means over windows of a quantity of each link, and of its distance from the mean before.

    Args:
        means: Shape (B, A, W).
        restlessness: Shape (B, A, W).
    """

    means: Tensor
    restlessness: Tensor

    def after(self, values: Tensor, heard: Tensor, started: Tensor, weights: Tensor) -> Followed:
        """Return the means after values (B, A); ``weights`` (B, A, W) is what all values weigh by now."""
        away = values[..., None] - self.means
        jumps = torch.where(started[..., None], away.abs(), 0.0)
        share = heard[..., None] / weights.clamp(min=1.0)
        return Followed(self.means + share * away, self.restlessness + share * (jumps - self.restlessness))


@dataclass(frozen=True)
class LinkEvidence:
    """Past of every link of a batch of devices.

    Args:
        ranges: Ranges followed.
        residuals: Residuals to what the other ranges say followed.
        weights: What the values of each window weigh together, shape (B, A, W).
        loss: Share of intervals without the link, 10 s, shape (B, A).
        t_s: Time of each link's last reading, shape (B, A), seconds.
        heard: True once a link was heard, shape (B, A).
        started: True once a device was there, shape (B,).
    """

    ranges: Followed
    residuals: Followed
    weights: Tensor
    loss: Tensor
    t_s: Tensor
    heard: Tensor
    started: Tensor

    @classmethod
    def before(cls, devices: int, access_points: int) -> LinkEvidence:
        """Return the evidence before the first interval."""
        links = torch.zeros(devices, access_points, dtype=torch.float64)
        windows = torch.zeros(devices, access_points, len(WINDOWS_S), dtype=torch.float64)
        still = Followed(windows, windows)
        return cls(
            ranges=still,
            residuals=still,
            weights=windows,
            loss=links,
            t_s=links,
            heard=links > 0,
            started=torch.zeros(devices, dtype=torch.bool),
        )

    def after(
        self, intervals: Intervals, dt_s: Tensor, expected: RangeExpectation
    ) -> tuple[LinkEvidence, Tensor]:
        """Return the evidence after an interval, and the features of its links.

        Args:
            intervals: One of every device.
            dt_s: Time since the interval before, shape (B,), seconds; 0 for absent devices.
            expected: What the ranges were expected to be.

        Returns:
            The evidence, and ``FEATURES``, shape (B, A, F); those of links not heard mean nothing.
        """
        present = intervals.present[:, None]
        heard = intervals.heard & present
        ranges = intervals.ranges.double()
        residual = ranges - expected.by_others

        now = torch.maximum(intervals.t_s.double()[:, None], self.t_s)
        silence = (now - self.t_s).clamp(max=LONGEST_SILENCE_S)
        remembered = torch.exp(-silence[..., None] / torch.tensor(WINDOWS_S, dtype=torch.float64))
        weights = torch.where(heard[..., None], remembered * self.weights + 1, self.weights)
        forgotten = torch.exp(-dt_s / WINDOWS_S[-1])[:, None]
        missed = (~heard).double()
        loss = torch.where(self.started[:, None], missed + forgotten * (self.loss - missed), missed)
        new = LinkEvidence(
            ranges=self.ranges.after(ranges, heard, self.heard, weights),
            residuals=self.residuals.after(residual, heard, self.heard, weights),
            weights=weights,
            loss=torch.where(present, loss, self.loss),
            t_s=torch.where(heard, now, self.t_s),
            heard=self.heard | heard,
            started=self.started | intervals.present,
        )
        features = [
            ranges.clamp(max=FARTHEST_RANGE_M),
            residual,
            ranges - expected.by_all,
            expected.spread.log(),
            new.residuals.means[..., 1],
            new.residuals.restlessness[..., 1],
            new.ranges.restlessness[..., 0],
            new.ranges.restlessness[..., 1],
            new.loss,
            intervals.rss.double(),
        ]
        return new, torch.stack(features, -1)
