"""What every link of a device says of its own range, by means that carry over from phone to phone.

Signal strengths and spreads differ by 10 dB and a factor of 2 between phones: both are taken against a running
percentile of the phone's own readings, the former after the loss of free space is added back.

Axes: B devices, A access points, W windows, Q bins, F features.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import FARTHEST_RANGE_M, Intervals

WINDOWS_S = (2.0, 10.0)
"""Time constants of a link's recent past: a few steps, and the stretch over which errors of places last."""
MEMORY_S = 300.0
"""Time constant of the percentiles of a phone: minutes, so that a change of hands is forgotten."""
LONGEST_SILENCE_S = 30.0
SMALLEST_STD_M = 0.02
FEATURES = (
    "range",
    "range against what the others say",
    "range against what all say",
    "spread of what the others say",
    "the same residual, 10 s mean",
    "the same residual, 10 s restlessness",
    "range, 2 s restlessness",
    "range, 10 s restlessness",
    "signal strength",
    "signal strength, 2 s mean",
    "signal strength, 10 s mean",
    "signal strength, 10 s restlessness",
    "burst spread",
    "loss rate",
)
"""Names of the axis F."""
VIEWS = (tuple(range(len(FEATURES))), (*range(8), len(FEATURES) - 1))
"""Features that a network sees: all of them, or all but what phones say of their signals."""


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
class RunningPercentile:
    """Percentile of the values of each device up to now.

    Args:
        low: Lower end of the first bin.
        width: Of a bin.
        quantile: Which, 0 to 1.
        counts: Weights of the values in each bin, shape (B, Q); the last bins hold what lies beyond.
    """

    low: float
    width: float
    quantile: float
    counts: Tensor

    def after(self, values: Tensor, heard: Tensor, kept: Tensor) -> RunningPercentile:
        """Return the percentile after values (B, A), where ``heard``; older ones count ``kept`` (B,) as much."""
        last = self.counts.shape[1] - 1
        bins = ((values - self.low) / self.width).floor().long().clamp(0, last)
        counts = (self.counts * kept[:, None]).scatter_add(1, bins, heard.double())
        return RunningPercentile(self.low, self.width, self.quantile, counts)

    @property
    def values(self) -> Tensor:
        """Centre of the bin that holds the percentile, shape (B, 1)."""
        below = self.counts.cumsum(1) < self.quantile * self.counts.sum(1, keepdim=True)
        index = below.sum(1, keepdim=True).clamp(max=self.counts.shape[1] - 1)
        return self.low + self.width * (index + 0.5)


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
        strengths: Of signals with the loss of free space added back.
        stds: Of logarithms of burst spreads.
        ranges: Ranges followed.
        signals: Normalised signal strengths followed.
        residuals: Residuals to what the other ranges say followed.
        weights: What the values of each window weigh together, shape (B, A, W).
        loss: Share of intervals without the link, 10 s, shape (B, A).
        t_s: Time of each link's last reading, shape (B, A), seconds.
        heard: True once a link was heard, shape (B, A).
        started: True once a device was there, shape (B,).
    """

    strengths: RunningPercentile
    stds: RunningPercentile
    ranges: Followed
    signals: Followed
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
            strengths=RunningPercentile(-90.0, 1.0, 0.8, torch.zeros(devices, 80, dtype=torch.float64)),
            stds=RunningPercentile(-4.0, 0.1, 0.5, torch.zeros(devices, 60, dtype=torch.float64)),
            ranges=still,
            signals=still,
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
        kept = torch.where(intervals.present, torch.exp(-dt_s / MEMORY_S), 1.0)
        free_space_db = intervals.rss.double() + 20 * ranges.clamp(min=1.0).log10()
        strengths = self.strengths.after(free_space_db, heard, kept)
        signal = free_space_db - strengths.values
        log_std = intervals.stds.double().clamp(min=SMALLEST_STD_M).log()
        stds = self.stds.after(log_std, heard, kept)
        residual = ranges - expected.by_others

        now = torch.maximum(intervals.t_s.double()[:, None], self.t_s)
        silence = (now - self.t_s).clamp(max=LONGEST_SILENCE_S)
        remembered = torch.exp(-silence[..., None] / torch.tensor(WINDOWS_S, dtype=torch.float64))
        weights = torch.where(heard[..., None], remembered * self.weights + 1, self.weights)
        forgotten = torch.exp(-dt_s / WINDOWS_S[-1])[:, None]
        missed = (~heard).double()
        loss = torch.where(self.started[:, None], missed + forgotten * (self.loss - missed), missed)
        new = LinkEvidence(
            strengths=strengths,
            stds=stds,
            ranges=self.ranges.after(ranges, heard, self.heard, weights),
            signals=self.signals.after(signal, heard, self.heard, weights),
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
            signal,
            new.signals.means[..., 0],
            new.signals.means[..., 1],
            new.signals.restlessness[..., 1],
            log_std - stds.values,
            new.loss,
        ]
        return new, torch.stack(features, -1)
