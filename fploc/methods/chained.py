"""Methods chained through another device: where it is stands in for one more access point.

The paper chains all rivals of its two-device experiment so: with two access points in reach, device 2 takes the
estimate of device 1 as its third anchor, at the range of the link between them.

Axes: B intervals, A access points.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from fploc.intervals import Estimate, Intervals
from fploc.methods.one_shot import OneShotMethod


@dataclass(frozen=True)
class Companion:
    """The other device of each interval.

    Args:
        positions: Where it is, shape (B, 2), metres, site frame; 0 where ``there`` is False.
        covariances: Of these, shape (B, 2, 2), square metres.
        ranges: Of the link to it, without their offset, shape (B,), metres.
        variances: Of these and of their offset together, shape (B,), square metres.
        there: True where both are known, shape (B,).
    """

    positions: Tensor
    covariances: Tensor
    ranges: Tensor
    variances: Tensor
    there: Tensor

    @property
    def sigmas(self) -> Tensor:
        """Standard deviation of the ranges as ranges to known places, shape (B,), metres.

        What the place adds depends on the direction, which is not known yet: its mean over all directions.
        """
        of_place = self.covariances.diagonal(dim1=-2, dim2=-1).mean(-1)
        return (self.variances + of_place).sqrt()

    def at(self, rows: slice) -> Companion:
        """Return the companions of some of the intervals."""
        return Companion(**{one.name: getattr(self, one.name)[rows] for one in fields(self)})

    def anchors(self, access_points: Tensor) -> Tensor:
        """Return access points (A, 2) and the device behind them, shape (B, A + 1, 2), metres."""
        everywhere = access_points.to(self.positions).expand(len(self.positions), *access_points.shape)
        return torch.cat([everywhere, self.positions[:, None, :]], dim=1)

    def behind(self, values: Tensor, own: Tensor) -> Tensor:
        """Return values of links (B, A) with the device's own (B,) behind them, shape (B, A + 1)."""
        return torch.cat([values, own[:, None].to(values)], dim=1)


def chained(
    method: OneShotMethod,
    access_points: Tensor,
    intervals: Intervals,
    companion: Companion,
    *,
    range_sd_m: float,
) -> Estimate:
    """Solve every interval with the other device as one more access point.

    Its range gets the standard deviation that the method gives to ranges, multiplied by how much more uncertain
    than a range to an access point it is: methods give numbers of their own choice, not metres.

    Args:
        method: Whose solver is used.
        access_points: Shape (A, 2), metres, site frame.
        intervals: Of one device each.
        companion: The other device of each.
        range_sd_m: Standard deviation of a range to an access point, metres.
    """
    anchors = companion.anchors(access_points)
    nothing = torch.zeros_like(companion.ranges)
    wider = replace(
        intervals,
        ranges=companion.behind(intervals.ranges.double(), companion.ranges),
        stds=companion.behind(intervals.stds, nothing),
        rss=companion.behind(intervals.rss, nothing),
        heard=companion.behind(intervals.heard, companion.there),
    )

    def solver(ranges: Tensor, _: Tensor, sigmas: Tensor, heard: Tensor, /) -> Estimate:
        doubt = companion.behind(torch.ones_like(sigmas[:, :-1]), companion.sigmas / range_sd_m)
        return method.solver(ranges, anchors, sigmas * doubt, heard)

    return replace(method, solver=solver).step(access_points, wider)[1]
