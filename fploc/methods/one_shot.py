"""Methods that solve every interval alone: a solver with the interface of design §5.9.

Axes: B intervals, A access points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from fploc.intervals import Estimate, Intervals
from fploc.sites.site import Site


@runtime_checkable
class Memoryless(Protocol):
    """A method whose ``step`` returns its state unchanged and treats every row of the batch alone.

    The localizer hands such a method many intervals of a recording as one batch, which gives the same numbers
    as the scan over time. Declaring ``memoryless`` promises both.
    """

    memoryless: ClassVar[bool]


class RangeSolver(Protocol):
    """A solver of ``fploc.solvers``."""

    def __call__(self, ranges: Tensor, access_points: Tensor, sigmas: Tensor, heard: Tensor, /) -> Estimate:
        """Solve for positions; shapes as in ``fploc.solvers.nonlinear.solve_nonlinear``."""


@dataclass
class OneShotMethod:
    """A range solver as a method. Its state is the access points' positions, shape (A, 2), metres.

    Args:
        name: Of the method.
        solver: Solves one batch of intervals.
        default_calibration: That it runs with unless asked.
        sigma_m: Standard deviation given to a range of 0 m, metres: the phone's own spread of a burst says
            nothing of walls, which make most of the error.
        sigma_per_m: What every metre of a range adds to it: longer ways cross more walls.
    """

    name: str
    solver: RangeSolver
    default_calibration: str
    sigma_m: float = 1.0
    sigma_per_m: float = 0.0
    memoryless: ClassVar[bool] = True

    def init(self, site: Site, devices: int) -> Tensor:
        """Return the access points' positions; they serve any number of devices."""
        return torch.from_numpy(site.positions_m)

    def step(self, state: Tensor, intervals: Intervals) -> tuple[Tensor, Estimate]:
        """Solve one interval of every device."""
        ranges = intervals.ranges.double()
        access_points = state.to(ranges.device)
        sigmas = self.sigma_m + self.sigma_per_m * ranges
        return state, self.solver(ranges, access_points, sigmas, intervals.heard)
