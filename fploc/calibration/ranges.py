"""Slant ranges to calibrated ranges in the plan: the offset is subtracted first, then the height."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording
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


def calibrated_plan_ranges(recording: Recording, site: Site, offsets: RangeOffsets) -> NDArray[np.float64]:
    """Return a recording's ranges in the plan without their offset, shape (T, A), metres; 0 where not heard."""
    calibrated = torch.from_numpy(offsets.apply(recording.slant_m, site.macs))
    in_plan = plan_ranges(calibrated, torch.from_numpy(site.height_differences_m)).numpy()
    return np.where(recording.heard, in_plan, 0.0)
