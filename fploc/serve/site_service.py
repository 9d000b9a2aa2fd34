"""A site in service: takes messages in, ticks, stores, and tells whoever listens."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from sqlalchemy.exc import SQLAlchemyError

from fploc.localizer import Localizer
from fploc.serve.admission import Verdict
from fploc.serve.live import Live
from fploc.serve.messages import VERSION, Measurements, PlanPlace, Receipt
from fploc.serve.metrics import Metrics
from fploc.serve.refusals import RefusedError
from fploc.serve.session import Batch, Computed, Ingested, Outcome, SiteSession
from fploc.serve.settings import ServeSettings
from fploc.serve.store import Store
from fploc.serve.upload_turns import UploadTurns
from fploc.serve.writer import StoreWriter

CLEAN_EVERY_S = 600.0
STORE_WAIT_S = 10.0
MOST_TICKS_UNSTORED = 10
ASIDE_SHARE = 0.5
"""Of a tick: batches that take longer are computed in a thread of their own. Shorter ones take much longer there: a
method of many small operations waits before each for the thread that answers requests."""

log = logging.getLogger("fploc.serve")


@dataclass(frozen=True)
class ServedSite:
    """A site as it is handed to the server.

    Args:
        localizer: Method, offsets and filter.
        plan: Its place; ``url`` is where the server gives the picture out.
        plan_png: The picture.
        speed_prior_mps: How fast the filter takes people to be.
    """

    localizer: Localizer
    plan: PlanPlace
    plan_png: bytes
    speed_prior_mps: float


def now_ms() -> float:
    """Return the server's clock, milliseconds since 1970."""
    return time.time() * 1000.0


class SiteService:
    """A site, its live connections and its ticks.

    Args:
        site: The site.
        settings: Limits and times.
        store: What survives.
        writer: Writes to it.
        uploads: Whose turn it is to upload, where ticks fall behind.
        metrics: Where things are counted.
    """

    def __init__(
        self,
        site: ServedSite,
        settings: ServeSettings,
        store: Store,
        writer: StoreWriter,
        uploads: UploadTurns,
        metrics: Metrics,
    ) -> None:
        self.site = site
        self.settings = settings
        self.session = SiteSession(site.localizer, settings)
        self.live = Live()
        self.tick_number = 0
        self.is_failing = False
        self.is_overloaded = False
        self._store = store
        self._writer = writer
        self._uploads = uploads
        self._metrics = metrics
        self._ticking = asyncio.Lock()
        self._computer = ThreadPoolExecutor(1, thread_name_prefix="fploc-compute")
        self._compute_s = 0.0
        self._storing: deque[Future[None]] = deque()
        self._clean_at = time.monotonic()

    @property
    def name(self) -> str:
        """Name of the site."""
        return self.session.name

    def restore(self) -> None:
        """Follow the devices that were followed when the server ended."""
        for device in self._store.followed(self.name, now_ms() - self.settings.forget_ms):
            self.session.restore(*self._store.device(self.name, device), device)

    def require_room(self, sender: str) -> None:
        """Do nothing where something more may wait; to be asked before a message is read.

        Args:
            sender: Whose turn it is; where there is no room it stays so.

        Raises:
            RefusedError: If too much waits.
        """
        if self.session.is_full:
            self._uploads.give_back(sender)
            raise RefusedError(503, "overloaded", "too much waits: send it again later", retry_after_s=2)

    async def receive(self, message: Measurements, sender: str) -> Receipt:
        """Take a message in; once this returns, what it accepted is stored.

        Args:
            message: Checked.
            sender: Whose turn it is; where there is no room it stays so.

        Raises:
            RefusedError: If there is no room for it, or it cannot be stored.
        """
        session = self.session
        if not session.has_room_for(message.device):
            raise RefusedError(
                429,
                "too_many_devices",
                f"{self.name} follows {len(session.devices)} devices",
                retry_after_s=60,
            )
        if not session.has_room_for_intervals(message.device, len(message.intervals)):
            self._uploads.give_back(sender)
            raise RefusedError(
                503, "overloaded", "too much of this device waits: send it again later", retry_after_s=2
            )
        if message.device not in session.devices:
            stored = await asyncio.to_thread(self._store.device, self.name, message.device)
            if message.device not in session.devices:
                session.restore(*stored, message.device)
        self._uploads.charge(sender, len(message.intervals))
        done = session.ingest(message, now_ms())
        try:
            await asyncio.wrap_future(self._writer.write(done.rows, []))
        except SQLAlchemyError as error:
            session.withdraw(done.rows)
            raise RefusedError(
                503, "not_stored", "the database refused it: send it again", retry_after_s=2
            ) from error
        return self._counted(done)

    def _counted(self, done: Ingested) -> Receipt:
        counts = {verdict: done.verdicts[verdict] for verdict in Verdict}
        self._metrics.accepted.labels(self.name).inc(counts[Verdict.ACCEPTED])
        for verdict in (Verdict.DUPLICATE, Verdict.LATE, Verdict.SKEWED):
            if counts[verdict]:
                self._metrics.not_used.labels(self.name, str(verdict)).inc(counts[verdict])
        self._metrics.unknown_access_points.labels(self.name).inc(done.unknown_access_points)
        self._metrics.links.labels(self.name).inc(done.links)
        return Receipt(
            accepted=counts[Verdict.ACCEPTED],
            duplicate=counts[Verdict.DUPLICATE],
            late=counts[Verdict.LATE],
            skewed=counts[Verdict.SKEWED],
            unknown_access_points=done.unknown_access_points,
        )

    async def run(self) -> None:
        """Tick forever."""
        period_s = self.settings.tick_ms / 1000.0
        due = time.monotonic() + period_s
        held_up_before_s = 0.0
        while True:
            asked = max(due, time.monotonic())
            await asyncio.sleep(asked - time.monotonic())
            began = time.monotonic()
            late_s = began - due
            used = 0
            try:
                used = await self.tick(now_ms() - 1000.0 * late_s)
                self.is_failing = False
            except Exception:
                # What was not computed still waits in the store; one fault must not stop all other devices.
                log.exception("tick %d of %s", self.tick_number, self.name)
                self.is_failing = True
            self._metrics.latency.labels(self.name).observe(time.monotonic() - due)
            held_up_s = began - asked
            pressure = max(
                # A single hiccup is no overload.
                min(held_up_s, held_up_before_s) / (self.settings.late_share * period_s),
                self.session.waiting / (self.settings.waiting_share * self.settings.most_waiting),
            )
            held_up_before_s = held_up_s
            self._uploads.note_tick(self.name, pressure, used)
            self._metrics.upload_wait.set(self._uploads.line_s)
            due += period_s
            missed = int((time.monotonic() - due) / period_s)
            if missed > 0:
                self._metrics.missed_ticks.labels(self.name).inc(missed)
                due += missed * period_s
            self.is_overloaded = missed > 0 or self._uploads.is_shedding

    async def tick(self, due_ms: float) -> int:
        """Advance what waits, store it, tell whoever listens, and return how many reading sets were used."""
        self.tick_number += 1
        async with self._ticking:
            outcomes = await self._advance()
            if outcomes:
                await self._wait_for_the_store()
                self._storing.append(self._writer.write([], outcomes))
            gone = self.session.forget_silent(now_ms())
            if gone.states:
                self._storing.append(self._writer.write([], [gone]))
        self.live.publish(self.text(due_ms))
        for fix in (fix for outcome in outcomes for fix in outcome.fixes):
            self._metrics.fixes.labels(self.name, fix.reason).inc()
        self._metrics.ticks.labels(self.name).inc()
        self._metrics.devices.labels(self.name).set(len(self.session.devices))
        self._metrics.waiting.labels(self.name).set(self.session.waiting)
        self._metrics.live.labels(self.name).set(len(self.live))
        if time.monotonic() >= self._clean_at:
            self._clean_at = time.monotonic() + CLEAN_EVERY_S
            await asyncio.to_thread(self._store.forget_fixes, now_ms() - self.settings.keep_tracks_ms)
        return sum(len(outcome.fixes) for outcome in outcomes)

    async def _wait_for_the_store(self) -> None:
        """Wait where the store lags behind by many ticks, so that what it has still to write stays bounded."""
        while self._storing and self._storing[0].done():
            self._storing.popleft()
        if len(self._storing) >= MOST_TICKS_UNSTORED:
            await asyncio.wait({asyncio.wrap_future(self._storing[0])}, timeout=STORE_WAIT_S)

    async def _advance(self) -> list[Outcome]:
        """Advance round by round while the tick's share of time lasts."""
        loop = asyncio.get_running_loop()
        until = time.monotonic() + self.settings.compute_share * self.settings.tick_ms / 1000.0
        outcomes = []
        while (batch := self.session.take()) is not None:
            if self._compute_s > ASIDE_SHARE * self.settings.tick_ms / 1000.0:
                computed = await loop.run_in_executor(self._computer, self._compute, batch)
            else:
                computed = self._compute(batch)
            outcomes.append(self.session.apply(computed))
            if time.monotonic() > until:
                break
        return outcomes

    def _compute(self, batch: Batch) -> Computed:
        """Advance a batch, and note what it took of the processor."""
        began_s = time.thread_time()
        computed = self.session.compute(batch)
        self._compute_s = time.thread_time() - began_s
        return computed

    async def forget(self, device: str) -> bool:
        """Delete all that is known of a device, and return whether anything was."""
        async with self._ticking:
            was_known = device in self.session.devices
            if was_known:
                self.session.forget(device)
            await asyncio.wrap_future(self._writer.write([], []))
            was_stored = await asyncio.to_thread(self._store.is_known, self.name, device)
            await asyncio.to_thread(self._store.forget_device, self.name, device)
        return was_known or was_stored

    def text(self, due_ms: float) -> str:
        """Return the latest of all devices as the JSON of ``messages.Positions``."""
        return json.dumps(
            {
                "version": VERSION,
                "site": self.name,
                "tick": self.tick_number,
                "server_ms": due_ms,
                "is_overloaded": self.is_overloaded,
                "devices": self.session.positions(now_ms()),
            },
            allow_nan=False,
        )

    def close(self) -> None:
        """End the thread that computes, and hand in the states as they are."""
        self._computer.shutdown()
        self._writer.write([], [self.session.unstored()])
