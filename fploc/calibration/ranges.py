"""What phones report to calibrated intervals: the offset is subtracted from slant ranges first, then the height.

Axes: B recordings, T intervals, A access points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording, pad
from fploc.intervals import Intervals, usual_rss
from fploc.plausible import has_range, has_rss
from fploc.sites.site import Site


def plan_ranges(slant_m: Tensor, height_differences_m: Tensor) -> Tensor:
    """Project slant ranges to the plan: √max(0, d² − h²).

    Args:
        slant_m: Calibrated ranges in space, shape (…, A), metres.
        height_differences_m: Height of each access point above the devices, shape (A,), metres.

    Returns:
        Shape (…, A), metres.
    """
    return (slant_m.clamp(min=0.0).square() - height_differences_m.square()).clamp(min=0.0).sqrt()


def calibrated_intervals(
    site: Site,
    offsets: RangeOffsets,
    *,
    t_s: Tensor,
    slant_m: Tensor,
    stds_m: Tensor,
    rss_dbm: Tensor,
    present: Tensor,
) -> Intervals:
    """Return what phones report as intervals. An access point is heard where it has a range.

    Args:
        site: Its access points, in the order of the axis A.
        offsets: Subtracted from slant ranges.
        t_s: Device time, shape (…), seconds.
        slant_m: Slant ranges, shape (…, A), metres; 0, negative or NaN where there is none.
        stds_m: The phones' own spreads of ranges, shape (…, A), metres; 0 where unknown.
        rss_dbm: Received signal strengths, shape (…, A), dBm; 0 or NaN where unknown.
        present: True where there is an interval, shape (…).
    """
    heard = has_range(slant_m)
    offsets_m = torch.from_numpy(offsets.per_access_point_m(site.macs))
    in_plan = plan_ranges(slant_m - offsets_m, torch.from_numpy(site.height_differences_m))
    ranges = torch.where(heard, in_plan, 0.0)
    rss = torch.where(has_rss(rss_dbm), rss_dbm, usual_rss(ranges))
    return Intervals(
        t_s=t_s,
        ranges=ranges,
        stds=torch.where(heard, stds_m, 0.0),
        rss=torch.where(heard, rss, 0.0),
        heard=heard,
        present=present,
    )


def recorded_intervals(recordings: Sequence[Recording], site: Site, offsets: RangeOffsets) -> Intervals:
    """Return the calibrated intervals of recordings side by side, shape (T, B, …); shorter ones end earlier."""
    padded = pad(recordings)
    return calibrated_intervals(
        site,
        offsets,
        t_s=torch.from_numpy(padded.t_s),
        slant_m=torch.from_numpy(padded.slant_m),
        stds_m=torch.from_numpy(padded.std_m),
        rss_dbm=torch.from_numpy(padded.rss_dbm),
        present=torch.from_numpy(padded.present),
    )


def calibrated_plan_ranges(recording: Recording, site: Site, offsets: RangeOffsets) -> NDArray[np.float64]:
    """Return a recording's ranges in the plan without their offset, shape (T, A), metres; 0 where not heard."""
    return recorded_intervals([recording], site, offsets).ranges[:, 0].numpy()
