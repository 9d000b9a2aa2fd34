"""The one interface of filters over positions of a batch of devices."""

from __future__ import annotations

from typing import Any, Protocol

from torch import Tensor

from fploc.intervals import Estimate


class Filter(Protocol):
    """Follows devices through time. ``State`` is the filter's own, a structure of tensors (B, …)."""

    def init(self, devices: int) -> Any:
        """Return the state of ``devices`` tracks before their first fix."""

    def step(self, state: Any, t_s: Tensor, present: Tensor, fixes: Estimate) -> tuple[Any, Estimate]:
        """Advance every device that is present by one interval.

        Args:
            state: Of the tracks.
            t_s: Time of the interval, shape (B,), seconds; a time before the track's own counts as equal.
            present: True where the device has an interval, shape (B,); others keep their state.
            fixes: What a method found.

        Returns:
            The new state and the filtered estimate, whose reasons are those of ``fixes``.
        """
