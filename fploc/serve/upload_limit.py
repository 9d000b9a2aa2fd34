"""How many uploads are worked on at one time: fewer where ticks come late, more again where they do not.

What is taken in must come out in time: a queue of requests would only grow older. Phones that are turned away send
what they kept all at once later, which costs the server less. Requests come in at random, so all devices fare alike.
"""

from __future__ import annotations

from collections.abc import Callable

FEWEST = 4
LATE_SHARE = 0.5
"""Of a tick: positions that are out later than that take room from uploads, the next ones must be in time."""
KEPT_WHEN_LATE = 0.7
GIVEN_BACK = 1
SHEDDING_S = 1.0
"""Time after a refusal for which the server says that it sheds load."""


class UploadLimit:
    """Room for uploads: grows by one with each tick in time, shrinks by a share with each late one.

    Args:
        most: Uploads at one time.
        clock: Seconds, never backwards.
    """

    def __init__(self, most: int, clock: Callable[[], float]) -> None:
        self._most, self._clock = most, clock
        self._in_flight = 0
        self._refused_at = -float("inf")
        self.room = most

    def enter(self) -> bool:
        """Take up room for an upload, and return whether there was any."""
        if self._in_flight >= self.room:
            self._refused_at = self._clock()
            return False
        self._in_flight += 1
        return True

    def leave(self) -> None:
        """Give the room of an upload back."""
        self._in_flight -= 1

    def note_tick(self, latency_s: float, tick_s: float) -> None:
        """Note how long after it was due a tick's positions were out."""
        if latency_s > LATE_SHARE * tick_s:
            self.room = min(self._most, max(FEWEST, int(KEPT_WHEN_LATE * self.room)))
        else:
            self.room = min(self._most, self.room + GIVEN_BACK)

    @property
    def is_shedding(self) -> bool:
        """True where an upload was turned away within the last second."""
        return self._clock() - self._refused_at < SHEDDING_S
