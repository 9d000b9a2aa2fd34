"""The one interface of every way to localize: readings of an interval in, positions with covariances out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from torch import Tensor

from fploc.filters.kalman import BatchedFilter
from fploc.floorplan.plan import FloorPlan
from fploc.intervals import Estimate, Intervals
from fploc.sites.site import Site


class Method(Protocol):
    """A complete way to localize.

    Its state is a structure of tensors. The first axis of those that belong to devices is the device; their other
    axes may become shorter than before the first interval, where what is left out at the ends is 0.
    """

    @property
    def name(self) -> str:
        """Name on the command line and in result records."""

    def init(self, site: Site, devices: int) -> Any:
        """Return the state of ``devices`` devices before their first interval."""

    def step(self, state: Any, intervals: Intervals) -> tuple[Any, Estimate]:
        """Advance every device that is present by one interval."""


@runtime_checkable
class Refining(Protocol):
    """A method of three parts: coarse positions, a filter over these, and a refinement of every row alone.

    The localizer runs the first and the last part on many intervals at once; only the filter goes through
    time. Having the parts promises that ``step`` does the same one interval at a time, and that the state of
    ``coarse`` is the access points' positions, shape (A, 2), metres.
    """

    @property
    def name(self) -> str:
        """Name on the command line and in result records."""

    @property
    def coarse(self) -> Method:
        """Finds coarse positions, every interval alone."""

    @property
    def filter(self) -> BatchedFilter:
        """Smooths the coarse positions."""

    def rows_at_once(self, access_points: int) -> int:
        """Return how many rows ``refine`` should be given: bounds memory, not results."""

    def refine(self, access_points: Tensor, intervals: Intervals, coarse: Estimate) -> Estimate:
        """Return the estimates of rows (B, …) from their filtered coarse positions."""


@runtime_checkable
class Solving(Protocol):
    """A method of two parts: what it follows of every link through time, and a solver of every row alone.

    The localizer solves many intervals at once; only the first part goes through time. Having the parts promises
    that ``step`` does the same one interval at a time, and that no position enters the state, which names the
    access points' positions ``access_points``, shape (A, 2), metres. ``Rows`` is the method's own, a data class of
    tensors (B, …).
    """

    @property
    def name(self) -> str:
        """Name on the command line and in result records."""

    def init(self, site: Site, devices: int) -> Any:
        """Return the state of ``devices`` devices before their first interval."""

    def follow(self, state: Any, intervals: Intervals) -> tuple[Any, Any]:
        """Advance the links of every device that is present by one interval, and return the ``Rows`` to solve."""

    def solve(self, access_points: Tensor, rows: Any) -> Estimate:
        """Return the estimates of ``Rows``."""


@runtime_checkable
class Filtering(Protocol):
    """A method that is a filter over time itself: its fixes are never unfiltered ones."""

    def for_speed(self, speed_prior_mps: float) -> Method:
        """Return the method for people who walk at about ``speed_prior_mps``, metres per second."""


@runtime_checkable
class Smoothing(Protocol):
    """A method that can look back on whole recordings: offline, its positions know what came after them."""

    def both_ways(self, site: Site, intervals: Intervals) -> tuple[Estimate, Estimate]:
        """Return the estimates that ``step`` makes of intervals (T, B, …), and smoothed ones, shapes (T, B, …)."""


@runtime_checkable
class ReadsPlan(Protocol):
    """A method that uses the plan of its target where there is one."""

    def for_plan(self, plan: FloorPlan) -> Method:
        """Return the method for a site with this plan."""


@runtime_checkable
class Calibrated(Protocol):
    """A method whose parameters belong to one calibration, which it runs with unless another is asked for."""

    @property
    def default_calibration(self) -> str:
        """What ``--calibration`` takes."""


@dataclass(frozen=True)
class Examples:
    """Recordings of one site with ground truth, to learn from.

    Args:
        site: Where they were made.
        plan: Of that site; None where it has none.
        intervals: Calibrated, time first: shapes (T, B, …).
        labels: Ground truth, shape (T, B, 2), metres, site frame; NaN where there is none.
        devices: Device of each recording, shape (B,).
    """

    site: Site
    plan: FloorPlan | None
    intervals: Intervals
    labels: Tensor
    devices: Tensor


@runtime_checkable
class SourceFitted(Protocol):
    """A method that learns from source recordings within a minute, whenever it is asked for."""

    @property
    def name(self) -> str:
        """Name on the command line and in result records."""

    @property
    def default_calibration(self) -> str:
        """What ``--calibration`` takes."""

    @property
    def learns_places(self) -> bool:
        """True where it knows nothing outside of the site that it learned at."""

    def fitted(self, sources: Sequence[Examples]) -> Method:
        """Return the method that has learned from examples of every source site."""
