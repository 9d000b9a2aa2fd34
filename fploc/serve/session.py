"""One site, live: what devices sent, in order, and how a tick advances all of them as one batch.

A tick decides only when to compute. Each round of a tick takes the oldest waiting interval of every device, so
that a device's positions are the same however its intervals fall into ticks. ``take`` and ``apply`` belong to one
thread; ``compute`` may run in another, one batch at a time.

Axes: B devices of a batch, A access points.
"""

from __future__ import annotations

import json
import time
from bisect import insort
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.intervals import NoFix
from fploc.localizer import Localizer
from fploc.plausible import has_range
from fploc.serve.admission import DeviceClock, Verdict
from fploc.serve.device_states import DeviceStates
from fploc.serve.ellipse import ellipse95
from fploc.serve.messages import Interval, Measurements
from fploc.serve.rows import DeviceRow, FixRow, StateRow, WaitingRow
from fploc.serve.settings import ServeSettings


@dataclass(frozen=True)
class QueuedInterval:
    """An interval that waits; ``values`` are slant range, spread, RSS, shape (3, A), 0 where missing."""

    track: int
    recording: str
    t_ms: float
    received_ms: float
    values: NDArray[np.float64]
    truth: tuple[float, float] | None

    @property
    def order(self) -> tuple[int, float]:
        """Place in the queue."""
        return self.track, self.t_ms


@dataclass
class FollowedDevice:
    """A device and what is known of it.

    Args:
        clock: What of it was seen.
        waiting: Its intervals that wait, in order.
        slot: Where its state is; None until it is first computed.
        stored: State to begin from, where it was restored.
        state_track: Track that the state belongs to.
        state_ms: Time of the last interval that the state has seen; None before the first.
        unstored: Intervals that it has seen since it was stored.
        fix: Last fix with a position.
        last: What was made of its last interval.
        heard: Values of its last interval, shape (3, A).
    """

    clock: DeviceClock
    waiting: list[QueuedInterval] = field(default_factory=list)
    slot: int | None = None
    stored: bytes | None = None
    state_track: int = 0
    state_ms: float | None = None
    unstored: int = 0
    fix: FixRow | None = None
    last: FixRow | None = None
    heard: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Batch:
    """One interval of each of some devices.

    Args:
        devices: Names.
        queued: Their intervals.
        slots: Of their states, shape (B,).
        anew: Slots of those that begin a track, any shape (N,).
        values: Shape (B, 3, A).
    """

    devices: list[str]
    queued: list[QueuedInterval]
    slots: Tensor
    anew: Tensor
    values: NDArray[np.float64]


@dataclass(frozen=True)
class Computed:
    """What was made of a batch: estimates as arrays (B, 2), (B, 2, 2), (B,), and the states that are to be stored."""

    batch: Batch
    positions_m: NDArray[np.float64]
    covariances_m2: NDArray[np.float64]
    reasons: NDArray[np.int64]
    states: list[StateRow]


@dataclass(frozen=True)
class Outcome:
    """What is to be stored of a batch: every fix, how far devices have come, states of some of them."""

    fixes: list[FixRow]
    devices: list[DeviceRow]
    states: list[StateRow]


@dataclass(frozen=True)
class Ingested:
    """What became of a message.

    Args:
        verdicts: Number of intervals by verdict.
        unknown_access_points: Readings of access points that the site does not have.
        links: Readings of other devices.
        rows: Accepted intervals, to be stored before they are acknowledged.
    """

    verdicts: Counter[Verdict]
    unknown_access_points: int
    links: int
    rows: list[WaitingRow]


class SiteSession:
    """A site with the devices that are in it.

    Args:
        localizer: Method, offsets and filter of the site.
        settings: Limits and times.
    """

    def __init__(self, localizer: Localizer, settings: ServeSettings) -> None:
        self.localizer = localizer
        self.settings = settings
        self.devices: dict[str, FollowedDevice] = {}
        self.waiting = 0
        self._states = DeviceStates(localizer)
        self._column = {mac.lower(): index for index, mac in enumerate(localizer.site.macs)}

    @property
    def name(self) -> str:
        """Name of the site."""
        return self.localizer.site.name

    def has_room_for(self, device: str) -> bool:
        """Return whether the device is followed or may be."""
        return device in self.devices or len(self.devices) < self.settings.most_devices

    @property
    def is_full(self) -> bool:
        """True where nothing more may wait."""
        return self.waiting >= self.settings.most_waiting

    def has_room_for_intervals(self, device: str, count: int) -> bool:
        """Return whether so many more intervals of a device may wait: all devices share the room alike.

        One of which nothing waits may send a whole backlog, so that it is never refused for good.
        """
        followed = self.devices.get(device)
        own = 0 if followed is None else len(followed.waiting)
        others = len(self.devices) + (followed is None)
        fits = own + count <= max(1.0, self.settings.most_waiting / others)
        return fits or (own == 0 and not self.is_full)

    def restore(
        self, row: DeviceRow | None, state: StateRow | None, waiting: Iterable[WaitingRow], device: str
    ) -> None:
        """Follow a device from what was stored of it; None and nothing for one never seen.

        Intervals that were used after the state was stored are used again: it goes on from where it was.
        """
        followed = FollowedDevice(DeviceClock(self.settings))
        if row is not None:
            followed.clock = DeviceClock(
                self.settings,
                track=row.track,
                recording=row.recording,
                used_ms=row.t_ms,
                received_ms=row.received_ms,
            )
            followed.fix = followed.last = FixRow(**json.loads(row.fix)) if row.fix else None
        if state is not None:
            followed.state_track, followed.state_ms = state.track, state.t_ms
            if state.layout == self._states.layout:
                followed.stored = state.state
        self.devices[device] = followed
        for one in sorted(waiting, key=lambda entry: (entry.track, entry.t_ms)):
            clock = followed.clock
            if one.track < clock.track:
                continue
            while clock.track < one.track:
                clock.restart(one.recording)
            clock.accept(one.t_ms, one.received_ms)
            interval = Interval.model_validate_json(one.body)
            place = one.track, one.recording
            self._queue(followed, self._queued(interval, place, one.received_ms)[0])

    def ingest(self, message: Measurements, now_ms: float) -> Ingested:
        """Put the intervals of a message into the queue of its device, which is followed already.

        Args:
            message: Checked.
            now_ms: Server's clock.
        """
        followed = self.devices[message.device]
        clock = followed.clock
        clock.begin(message.recording, now_ms)
        verdicts: Counter[Verdict] = Counter()
        rows, unknown, links = [], 0, 0
        for interval in sorted(message.intervals, key=lambda one: one.t_ms):
            verdict = clock.judge(interval.t_ms)
            verdicts[verdict] += 1
            if verdict is not Verdict.ACCEPTED:
                continue
            queued, strangers = self._queued(interval, (clock.track, clock.recording), now_ms)
            self._queue(followed, queued)
            unknown += strangers
            links += len(interval.links)
            rows.append(
                WaitingRow(
                    site=self.name,
                    device=message.device,
                    track=clock.track,
                    recording=clock.recording,
                    t_ms=interval.t_ms,
                    received_ms=now_ms,
                    body=interval.model_dump_json(),
                )
            )
        return Ingested(verdicts, unknown, links, rows)

    def _queued(
        self, interval: Interval, place: tuple[int, str], now_ms: float
    ) -> tuple[QueuedInterval, int]:
        """Return an interval of a track, ``place`` its number and recording, and its unknown access points."""
        values = np.zeros((3, len(self._column)))
        unknown = 0
        for reading in interval.readings:
            column = self._column.get(reading.bssid.lower())
            if column is None:
                unknown += 1
                continue
            values[:, column] = (reading.range_m or 0.0, reading.range_std_m or 0.0, reading.rss_dbm or 0.0)
        truth = None if interval.truth is None else (interval.truth.x_m, interval.truth.y_m)
        return QueuedInterval(*place, interval.t_ms, now_ms, values, truth), unknown

    def _queue(self, followed: FollowedDevice, queued: QueuedInterval) -> None:
        insort(followed.waiting, queued, key=lambda one: one.order)
        self.waiting += 1

    def withdraw(self, rows: Sequence[WaitingRow]) -> None:
        """Take intervals out of the queue that could not be stored, as far as they still wait."""
        for row in rows:
            followed = self.devices[row.device]
            kept = [one for one in followed.waiting if one.order != (row.track, row.t_ms)]
            self.waiting -= len(followed.waiting) - len(kept)
            followed.waiting = kept
            followed.clock.withdraw(row.track, row.t_ms)

    def take(self) -> Batch | None:
        """Return the oldest waiting interval of each device, the longest waiting first; None without any."""
        ready = [name for name, followed in self.devices.items() if followed.waiting]
        if not ready:
            return None
        ready.sort(key=lambda name: self.devices[name].waiting[0].received_ms)
        chosen = ready[: self.settings.most_at_once]
        queued, slots, anew = [], [], []
        for name in chosen:
            followed = self.devices[name]
            one = followed.waiting.pop(0)
            followed.clock.use(one.track, one.t_ms)
            slot = self._slot(followed)
            if one.track != followed.state_track:
                anew.append(slot)
                followed.state_track = one.track
            followed.state_ms = one.t_ms
            followed.unstored += 1
            queued.append(one)
            slots.append(slot)
        self.waiting -= len(chosen)
        values = np.stack([one.values for one in queued])
        return Batch(chosen, queued, torch.tensor(slots), torch.tensor(anew, dtype=torch.int64), values)

    def _slot(self, followed: FollowedDevice) -> int:
        if followed.slot is None:
            followed.slot = self._states.take_slot()
            if followed.stored is not None:
                self._states.restore(followed.slot, followed.stored)
                followed.stored = None
            else:
                # Not the states of all new devices at the same time.
                followed.unstored = followed.slot % self.settings.store_states_every
        return followed.slot

    @torch.inference_mode()
    def compute(self, batch: Batch) -> Computed:
        """Advance the devices of a batch by their interval."""
        if len(batch.anew):
            self._states.reset(batch.anew)
        values = torch.from_numpy(batch.values)
        t_s = torch.tensor([one.t_ms for one in batch.queued], dtype=torch.float64) / 1000.0
        intervals = self.localizer.calibrated(t_s, *values.unbind(1))
        state, found = self.localizer.advance(self._states.gather(batch.slots), intervals)
        self._states.scatter(batch.slots, state)
        return Computed(
            batch=batch,
            positions_m=found.positions.double().numpy(),
            covariances_m2=found.covariances.double().numpy(),
            reasons=found.reasons.numpy(),
            states=self._states_of([name for name in batch.devices if self._is_due(self.devices[name])]),
        )

    def _is_due(self, followed: FollowedDevice) -> bool:
        """Return whether so much was seen that the state is to be stored."""
        return followed.unstored >= self.settings.store_states_every

    def _states_of(self, devices: Sequence[str]) -> list[StateRow]:
        """Return states of devices to be stored, and count them as stored."""
        rows = []
        for name in devices:
            followed = self.devices[name]
            assert followed.slot is not None
            assert followed.state_ms is not None, "it has seen an interval since it was stored"
            followed.unstored = 0
            rows.append(
                StateRow(
                    site=self.name,
                    device=name,
                    track=followed.state_track,
                    t_ms=followed.state_ms,
                    layout=self._states.layout,
                    state=self._states.packed(followed.slot),
                )
            )
        return rows

    def unstored(self) -> Outcome:
        """Return the states that are not stored yet, as when the session ends."""
        return Outcome([], [], self._states_of([name for name, one in self.devices.items() if one.unstored]))

    def apply(self, computed: Computed) -> Outcome:
        """Take what was computed as the latest of each device, and return what is to be stored."""
        fixes, rows = [], []
        everything = zip(
            computed.batch.devices,
            computed.batch.queued,
            computed.positions_m.tolist(),
            computed.covariances_m2.tolist(),
            computed.reasons.tolist(),
            strict=True,
        )
        for name, one, position, covariance, reason in everything:
            fix = self._fix(name, one, position, covariance, NoFix(reason))
            fixes.append(fix)
            followed = self.devices[name]
            followed.last, followed.heard = fix, one.values
            if fix.x_m is not None:
                followed.fix = fix
            rows.append(
                DeviceRow(
                    site=self.name,
                    device=name,
                    track=one.track,
                    recording=one.recording,
                    t_ms=_farthest(followed.clock, one),
                    received_ms=one.received_ms,
                    fix="" if followed.fix is None else json.dumps(vars(followed.fix)),
                )
            )
        return Outcome(fixes, rows, computed.states)

    def _fix(
        self,
        name: str,
        one: QueuedInterval,
        position: Sequence[float],
        covariance: Sequence[Sequence[float]],
        reason: NoFix,
    ) -> FixRow:
        fixed = reason is NoFix.FIXED
        return FixRow(
            site=self.name,
            device=name,
            track=one.track,
            recording=one.recording,
            t_ms=one.t_ms,
            received_ms=one.received_ms,
            x_m=position[0] if fixed else None,
            y_m=position[1] if fixed else None,
            variance_x_m2=covariance[0][0] if fixed else None,
            variance_y_m2=covariance[1][1] if fixed else None,
            covariance_xy_m2=covariance[0][1] if fixed else None,
            reason=reason.name.lower(),
            access_points=int(has_range(one.values[0]).sum()),
            method=self.localizer.method.name,
            truth_x_m=None if one.truth is None else one.truth[0],
            truth_y_m=None if one.truth is None else one.truth[1],
        )

    def tick(self, *, budget_s: float = float("inf")) -> list[Outcome]:
        """Advance everything that waits, round by round, for about so long; the first round is always done."""
        started = time.perf_counter()
        outcomes = []
        while (batch := self.take()) is not None:
            outcomes.append(self.apply(self.compute(batch)))
            if time.perf_counter() - started > budget_s:
                break
        return outcomes

    def forget_silent(self, now_ms: float) -> Outcome:
        """Stop following devices that have been silent for long, and return their states, to be stored."""
        gone = [
            name
            for name, followed in self.devices.items()
            if not followed.waiting and now_ms - followed.clock.received_ms > self.settings.forget_ms
        ]
        states = self._states_of([name for name in gone if self.devices[name].unstored])
        for name in gone:
            self.forget(name)
        return Outcome([], [], states)

    def forget(self, device: str) -> None:
        """Stop following a device."""
        followed = self.devices.pop(device)
        self.waiting -= len(followed.waiting)
        if followed.slot is not None:
            self._states.give_back(followed.slot)

    def positions(self, now_ms: float) -> list[dict[str, Any]]:
        """Return the latest of all devices as the fields of ``messages.Position``."""
        return [
            position_of(name, followed, now_ms, self.settings.silent_ms)
            for name, followed in self.devices.items()
            if followed.last is not None
        ]


def position_of(name: str, followed: FollowedDevice, now_ms: float, silent_ms: float) -> dict[str, Any]:
    """Return the latest of one device as the fields of ``messages.Position``."""
    last, fix = followed.last, followed.fix
    assert last is not None, "a device is shown from its first interval on"
    shown = fix if fix is not None and fix.track == last.track else None
    return {
        "device": name,
        "recording": last.recording,
        "t_ms": last.t_ms,
        "age_ms": None if shown is None else max(0.0, now_ms - shown.received_ms),
        "is_silent": now_ms - followed.clock.received_ms > silent_ms,
        "x_m": None if shown is None else shown.x_m,
        "y_m": None if shown is None else shown.y_m,
        "ellipse95": None if shown is None else _ellipse_of(shown),
        "reason": last.reason,
        "access_points": last.access_points,
        "method": last.method,
        "truth_x_m": last.truth_x_m,
        "truth_y_m": last.truth_y_m,
    }


def _ellipse_of(fix: FixRow) -> dict[str, float]:
    assert fix.variance_x_m2 is not None and fix.variance_y_m2 is not None
    assert fix.covariance_xy_m2 is not None
    return ellipse95(fix.variance_x_m2, fix.variance_y_m2, fix.covariance_xy_m2)


def _farthest(clock: DeviceClock, one: QueuedInterval) -> float:
    """Return the time of the last interval of a track that was used, which may be used again after a restart."""
    return one.t_ms if clock.used_ms is None or clock.track != one.track else clock.used_ms
