"""Turns of phones: each may upload as often as it likes; where the server falls behind they stand in line.

What is taken in must come out in time: a queue would only grow older. So past capacity work is let in at the rate
at which it comes out, and phones take turns: each has one place in the line, gets it when it first asks,
and goes to the end for its next upload, the farther behind the more its last one brought beyond others'. That is
least recently served first; neither asking more often nor larger uploads bring a larger share, and nobody finds
room by chance. The line is counted in work, not in seconds: turns come later or sooner as the rate changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

READING_SETS_OF_A_REQUEST = 10.0
"""A request costs the server about as much as so many reading sets: the unit of work here."""
MOST_FOR_ONE, LEAST_FOR_ONE = 1.5, 0.5
"""So much is let in for what came out, where the server is not at all behind, or far."""
LOWEST_PER_S = 200.0
"""So much work a second is let in, however little came out."""
UPLOAD_MEMORY = 0.05
"""Weight of the newest in the running mean of the work of an upload."""
MEMORY_S = 1.0
"""Time constant of the running mean of what comes out."""
SHORTEST_S = 1e-6
LONGEST_WAIT_S = 5.0
"""Told to a phone: by then its turn may be farther away than it was, or the line gone."""
SHEDDING_S = 2.0
"""Time after a refusal for which the server says that it sheds load."""
SHORTEST_LINE_S = 1.0
"""Phones are told whole seconds: a line that moves faster costs more than it spares, where the server keeps up."""
MOST_PHONES = 10_000


class UploadTurns:
    """The line, and the rate at which it moves.

    Args:
        clock: Seconds, never backwards.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._moved_at_s = self._ticked_at_s = clock()
        self._refused_at_s = -math.inf
        self._rate_per_s = math.inf
        self._reached = self._end = 0.0
        self._places: dict[str, float] = {}
        self._earliest: dict[str, float] = {}
        self._typical = 1.0 + READING_SETS_OF_A_REQUEST
        self._came_out_per_s = 0.0
        self._pressures: dict[str, float] = {}

    def wait_s(self, phone: str) -> float:
        """Return 0 where it is a phone's turn, which it then has taken; else how long it should wait, seconds.

        Args:
            phone: What tells it from others: its token.
        """
        if math.isinf(self._rate_per_s):
            return 0.0
        now_s = self._move()
        place = self._places.get(phone)
        if place is None:
            place = self._stood_in_line(phone)
        if place <= self._reached:
            del self._places[phone]
            return 0.0
        self._refused_at_s = now_s
        return min(LONGEST_WAIT_S, (place - self._reached) / self._rate_per_s)

    def _stood_in_line(self, phone: str) -> float:
        end = max(self._end, self._reached)
        place = max(end, self._earliest.pop(phone, 0.0))
        self._end = end + self._typical
        _put(self._places, phone, place)
        return place

    def _move(self) -> float:
        now_s = self._clock()
        self._reached += self._rate_per_s * (now_s - self._moved_at_s)
        self._moved_at_s = now_s
        return now_s

    def charge(self, phone: str, reading_sets: int) -> None:
        """Note how many reading sets a phone brought in its turn."""
        work = reading_sets + READING_SETS_OF_A_REQUEST
        excess = work - self._typical
        if not math.isinf(self._rate_per_s):
            if excess > 0.0:
                line = max(0.0, self._end - self._reached)
                _put(self._earliest, phone, self._reached + line * work / self._typical)
            # What cost more than its place in the line allowed for makes all behind it wait.
            self._reached -= excess
        self._typical += UPLOAD_MEMORY * excess

    def give_back(self, phone: str) -> None:
        """Note that the server had no room for what a phone brought in its turn: it stays its turn."""
        self._refused_at_s = self._clock()
        _put(self._places, phone, self._reached)

    def note_tick(self, site: str, pressure: float, reading_sets: int) -> None:
        """Note how far behind a site is, and what came out; the one that is farthest behind counts.

        Args:
            site: Its name.
            pressure: How far behind, as a share of how far it may be: above 1, less is let in than comes out.
            reading_sets: That were used in this tick.
        """
        now_s = self._clock()
        took_s = max(SHORTEST_S, now_s - self._ticked_at_s)
        self._ticked_at_s = now_s
        with_requests = self._typical / max(1.0, self._typical - READING_SETS_OF_A_REQUEST)
        came_out_per_s = with_requests * reading_sets / took_s
        self._came_out_per_s += -math.expm1(-took_s / MEMORY_S) * (came_out_per_s - self._came_out_per_s)
        self._pressures[site] = pressure
        pressure = max(self._pressures.values())
        if pressure <= 1.0 and self.line_s < SHORTEST_LINE_S:
            self._rate_per_s = math.inf
            return
        if math.isinf(self._rate_per_s):
            self._begin_line(now_s)
        self._move()
        for_one = MOST_FOR_ONE - (MOST_FOR_ONE - 1.0) * pressure
        self._rate_per_s = max(LOWEST_PER_S, max(LEAST_FOR_ONE, for_one) * self._came_out_per_s)

    def _begin_line(self, now_s: float) -> None:
        self._moved_at_s, self._rate_per_s = now_s, LOWEST_PER_S
        self._reached = self._end = 0.0
        self._places.clear()
        self._earliest.clear()

    @property
    def line_s(self) -> float:
        """How long a phone waits from now on that takes its place only now, seconds."""
        if math.isinf(self._rate_per_s):
            return 0.0
        return max(0.0, self._end - self._reached) / self._rate_per_s

    @property
    def is_shedding(self) -> bool:
        """True where a phone was told to wait within the last two seconds."""
        return self._clock() - self._refused_at_s < SHEDDING_S


def _put(places: dict[str, float], phone: str, place: float) -> None:
    """Note a place; the one noted first is forgotten where there are too many."""
    places.pop(phone, None)
    if len(places) >= MOST_PHONES:
        del places[next(iter(places))]
    places[phone] = place
