"""Order of a device's reading sets: what is new, what came before, what its clock cannot mean.

A device's state goes forward only. A reading set that is older than the last one used is late; one that was seen
before is a duplicate; one that jumps ahead of what the server's own clock allows is skewed. Clocks of phones have
any zero: nothing here compares them with the server's clock, only their steps.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum

from fploc.serve.settings import ServeSettings

FASTEST_REPLAY = 100.0
"""A recording may be replayed so many times as fast: a device's clock may run so much ahead of the server's."""
REMEMBERED = 1024
"""Times of reading sets already used that are told apart from late ones."""


class Verdict(StrEnum):
    """What becomes of a reading set."""

    ACCEPTED = "accepted"
    DUPLICATE = "duplicate"
    LATE = "late"
    SKEWED = "skewed"


class DeviceClock:
    """What times of a device were seen, and in which track.

    Args:
        settings: How far its clock may jump.
        track: Number of the device's track; grows where it starts anew.
        recording: As the device names it.
        used_ms: Time of the last interval that its state has seen; None before the first.
        received_ms: Server's clock when it was accepted.
    """

    def __init__(
        self,
        settings: ServeSettings,
        *,
        track: int = 0,
        recording: str = "",
        used_ms: float | None = None,
        received_ms: float = 0.0,
    ) -> None:
        self._settings = settings
        self.track = track
        self.recording = recording
        self.used_ms = used_ms
        self.newest_ms = used_ms
        self.received_ms = received_ms
        self._silence_ms = self._now_ms = 0.0
        self._waiting: set[float] = set()
        self._used: deque[float] = deque([] if used_ms is None else [used_ms], maxlen=REMEMBERED)

    def begin(self, recording: str, now_ms: float) -> None:
        """Note that a message of a recording came in at ``now_ms``; another recording starts a track anew."""
        self._silence_ms = max(0.0, now_ms - self.received_ms)
        self._now_ms = now_ms
        if recording != self.recording:
            self.restart(recording)

    def judge(self, t_ms: float) -> Verdict:
        """Return what becomes of a reading set at ``t_ms``, device clock, of the message that came in last."""
        if t_ms in self._waiting or t_ms in self._used:
            return Verdict.DUPLICATE
        jump = self._settings.longest_clock_jump_ms
        if self.newest_ms is not None:
            ahead_ms = t_ms - self.newest_ms
            if ahead_ms > max(jump, FASTEST_REPLAY * self._silence_ms):
                return Verdict.SKEWED
            if self.used_ms is not None and t_ms < self.used_ms:
                if -ahead_ms <= jump or self._silence_ms < self._settings.clock_restart_ms:
                    return Verdict.LATE
                self.restart(self.recording)
        self.accept(t_ms, self._now_ms)
        return Verdict.ACCEPTED

    def accept(self, t_ms: float, received_ms: float) -> None:
        """Note that an interval waits."""
        self._waiting.add(t_ms)
        self.newest_ms = t_ms if self.newest_ms is None else max(self.newest_ms, t_ms)
        self.received_ms = max(self.received_ms, received_ms)

    def withdraw(self, track: int, t_ms: float) -> None:
        """Note that an interval waits no more and was not used."""
        if track == self.track:
            self._waiting.discard(t_ms)

    def use(self, track: int, t_ms: float) -> None:
        """Note that an interval is taken out of the queue for the state to see."""
        if track != self.track:
            return
        self._waiting.discard(t_ms)
        self._used.append(t_ms)
        # After a restart the state sees reading sets again that it had seen.
        self.used_ms = t_ms if self.used_ms is None else max(self.used_ms, t_ms)

    def restart(self, recording: str) -> None:
        """Start a track anew."""
        self.track += 1
        self.recording = recording
        self.used_ms = self.newest_ms = None
        self._waiting.clear()
        self._used.clear()
