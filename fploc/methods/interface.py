"""The one interface of every way to localize: readings of an interval in, positions with covariances out."""

from __future__ import annotations

from typing import Any, Protocol

from fploc.intervals import Estimate, Intervals
from fploc.sites.site import Site


class Method(Protocol):
    """A complete way to localize. ``State`` is the method's own, a structure of tensors."""

    @property
    def name(self) -> str:
        """Name on the command line and in result records."""
        ...

    def init(self, site: Site, devices: int) -> Any:
        """Return the state of ``devices`` devices before their first interval."""
        ...

    def step(self, state: Any, intervals: Intervals) -> tuple[Any, Estimate]:
        """Advance every device that is present by one interval."""
        ...
