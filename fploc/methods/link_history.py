"""What each link of a device said up to now, as features that mean the same at every site.

Axes: B devices, A access points, W windows, F features.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Intervals

LONGEST_SILENCE_S = 30.0
"""Silences beyond it are all alike."""


@dataclass(frozen=True)
class LinkHistory:
    """Exponentially weighted means of every link over several windows.

    Args:
        ranges: Mean range, shape (B, A, W), metres.
        rss: Mean signal strength, shape (B, A, W), dBm.
        restlessness: Mean distance of a range from the mean range before it, shape (B, A, W), metres.
        t_s: Time of each link's last reading, shape (B, A), seconds.
        started: True once a link was heard, shape (B, A).
    """

    ranges: Tensor
    rss: Tensor
    restlessness: Tensor
    t_s: Tensor
    started: Tensor

    @classmethod
    def before(cls, devices: int, access_points: int, windows: int) -> LinkHistory:
        """Return the history before the first interval."""
        means = torch.zeros(devices, access_points, windows, dtype=torch.float64)
        links = means[..., 0]
        return cls(means, means, means, links, torch.zeros_like(links, dtype=torch.bool))

    def after(self, intervals: Intervals, windows_s: Tensor) -> tuple[LinkHistory, Tensor]:
        """Return the history after an interval, and the features of its links.

        Args:
            intervals: One of every device.
            windows_s: Time constants of the means, shape (W,), seconds.

        Returns:
            The history, and features of shape (B, A, F): range, its spread and signal strength; how many access
            points answered; how much farther and fainter this one is than the nearest and the loudest of them,
            and the share of them that is nearer; the time since its last reading; for each window, range and
            signal strength against their means and the restlessness. Those of links not heard mean nothing.
        """
        heard = intervals.heard & intervals.present[:, None]
        ranges, rss = intervals.ranges.double(), intervals.rss.double()
        now = torch.maximum(intervals.t_s.double()[:, None], self.t_s)
        silence_s = torch.where(self.started, now - self.t_s, LONGEST_SILENCE_S).clamp(max=LONGEST_SILENCE_S)
        kept = torch.where(self.started[..., None], torch.exp(-silence_s[..., None] / windows_s), 0.0)

        def followed(mean: Tensor, new: Tensor) -> Tensor:
            return torch.where(heard[..., None], kept * mean + (1 - kept) * new, mean)

        jump = torch.where(self.started[..., None], (ranges[..., None] - self.ranges).abs(), 0.0)
        new = LinkHistory(
            ranges=followed(self.ranges, ranges[..., None]),
            rss=followed(self.rss, rss[..., None]),
            restlessness=followed(self.restlessness, jump),
            t_s=torch.where(heard, now, self.t_s),
            started=self.started | heard,
        )
        count = heard.sum(-1, keepdim=True)
        is_nearer = heard[:, None, :] & (ranges[:, None, :] < ranges[:, :, None])
        single = [
            ranges,
            intervals.stds.double(),
            rss,
            count.expand_as(ranges).double(),
            ranges - torch.where(heard, ranges, torch.inf).amin(-1, keepdim=True),
            torch.where(heard, rss, -torch.inf).amax(-1, keepdim=True) - rss,
            is_nearer.sum(-1) / count.clamp(min=1),
            silence_s,
        ]
        means = [ranges[..., None] - new.ranges, rss[..., None] - new.rss, new.restlessness]
        return new, torch.cat([torch.stack(single, -1), *means], -1)
