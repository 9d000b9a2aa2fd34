"""How often each phone may upload: as often as it likes, less often where ticks begin late.

What is taken in must come out in time: a queue of requests would only grow older. All phones are held to the same
time between uploads, so all fare alike; what a phone kept meanwhile comes in one upload, which costs much less.
"""

from __future__ import annotations

from collections.abc import Callable

SHORTEST_S = 0.1
LONGEST_S = 5.0
WIDER = 1.3
NARROWER = 0.93
SHEDDING_S = 2.0
"""Time after a refusal for which the server says that it sheds load."""
MOST_PHONES = 10_000


class UploadSpacing:
    """Time between uploads of one phone: grows with each late tick, shrinks with each one in time.

    Args:
        clock: Seconds, never backwards.
        late_share: Of a tick: one that begins later than that waited for requests that were before it.
    """

    def __init__(self, clock: Callable[[], float], late_share: float) -> None:
        self._clock = clock
        self._late_share = late_share
        self._refused_at = -float("inf")
        self._uploaded_at: dict[str, float] = {}
        self.spacing_s = 0.0

    def wait_s(self, phone: str) -> float:
        """Return 0 where a phone may upload now, which is noted; else how long it must wait, seconds.

        Args:
            phone: What tells it from others: its token.
        """
        now = self._clock()
        wait_s = self._uploaded_at.get(phone, -float("inf")) + self.spacing_s - now
        if wait_s > 0.0:
            self._refused_at = now
            return wait_s
        self._uploaded_at.pop(phone, None)
        if len(self._uploaded_at) >= MOST_PHONES:
            del self._uploaded_at[next(iter(self._uploaded_at))]
        self._uploaded_at[phone] = now
        return 0.0

    def note_tick(self, late_s: float, tick_s: float) -> None:
        """Note how long after it was due a tick began."""
        if late_s > self._late_share * tick_s:
            self.spacing_s = min(LONGEST_S, max(SHORTEST_S, WIDER * self.spacing_s))
        else:
            narrower_s = NARROWER * self.spacing_s
            self.spacing_s = narrower_s if narrower_s >= SHORTEST_S else 0.0

    @property
    def is_shedding(self) -> bool:
        """True where a phone was told to wait within the last two seconds."""
        return self._clock() - self._refused_at < SHEDDING_S
