"""Phones that send recordings to a server, as real ones would: in time, now and then not at all, or late."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import httpx
import numpy as np

from fploc.errors import FplocError
from fploc.serve.messages import Interval, Measurements, Receipt

MOST_AT_ONCE = 200
LONGEST_WAIT_S = 10.0
GIVE_UP_S = 60.0
REFUSED_FOR_GOOD = (400, 401, 403, 404, 413, 415, 422)


@dataclass(frozen=True)
class Walk:
    """What one phone sends.

    Args:
        device: Name of the phone.
        recording: Name of the recording.
        intervals: What it measured, in order.
    """

    device: str
    recording: str
    intervals: Sequence[Interval]


@dataclass(frozen=True)
class Conditions:
    """How the phones send.

    Args:
        speed: Seconds of the recording that pass in one second.
        drop: Share of the reading sets that get lost.
        delay_ms: Longest delay of a reading set: each has its own, so that they overtake each other.
        seed: Of what is lost and late.
    """

    speed: float = 1.0
    drop: float = 0.0
    delay_ms: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        for option, value, fits, expected in (
            ("--speed", self.speed, 0 < self.speed <= 100, "a number above 0, up to 100"),
            ("--drop", self.drop, 0 <= self.drop < 1, "a share from 0 up to, not including, 1"),
            ("--delay-ms", self.delay_ms, 0 <= self.delay_ms <= 60_000, "milliseconds from 0 to 60000"),
        ):
            if not fits:
                raise FplocError(option, value=value, expected=expected, way_out="give another number")


@dataclass
class Sent:
    """What a phone has sent, and what became of it."""

    device: str
    dropped: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class Server:
    """Where the phones send to."""

    url: str
    site: str
    token: str | None

    def client(self) -> httpx.AsyncClient:
        """Return a client with connections that stay open."""
        headers = {} if self.token is None else {"Authorization": f"Bearer {self.token}"}
        try:
            return httpx.AsyncClient(base_url=self.url, headers=headers, timeout=10.0)
        except httpx.InvalidURL as error:
            raise self._unusable(str(error)) from error

    @property
    def path(self) -> str:
        """Where measurements go."""
        return f"/v1/sites/{self.site}/measurements"

    def _unusable(self, reason: str) -> FplocError:
        return FplocError(
            f"--url {self.url}",
            value=reason,
            expected="a server of fploc",
            way_out="start one with `fploc serve --site SITE`",
        )

    def refused(self, status: int, answer: str) -> FplocError:
        """Return the error of an answer that sending again does not help."""
        return FplocError(
            f"{self.url}{self.path}",
            value=f"{status} {answer[:200]}",
            expected="202 Accepted",
            way_out="check --url, --to and --token (`fploc serve token --scope upload` makes one)",
        )

    def gone(self) -> FplocError:
        """Return the error of a server that does not answer."""
        return self._unusable("no answer")


async def send_walks(server: Server, walks: Sequence[Walk], conditions: Conditions) -> list[Sent]:
    """Send walks, all phones at once, and return what became of them.

    A phone keeps what the server did not take and sends it again, together with what came since.

    Raises:
        FplocError: If the server refuses them, or does not answer for a minute.
    """
    async with server.client() as client:
        random = np.random.default_rng(conditions.seed)
        seeds = random.integers(0, 2**32, len(walks)).tolist()
        phones = [
            _send(client, server, walk, conditions, np.random.default_rng(seed))
            for walk, seed in zip(walks, seeds, strict=True)
        ]
        tasks = [asyncio.create_task(phone) for phone in phones]
        try:
            return list(await asyncio.gather(*tasks))
        finally:
            for task in tasks:
                task.cancel()


async def _send(
    client: httpx.AsyncClient, server: Server, walk: Walk, conditions: Conditions, random: np.random.Generator
) -> Sent:
    t_s = np.array([one.t_ms for one in walk.intervals]) / 1000.0
    due_s = (t_s - t_s[0]) / conditions.speed + random.uniform(0.0, conditions.delay_ms / 1000.0, len(t_s))
    kept = random.random(len(t_s)) >= conditions.drop
    sent = Sent(walk.device, dropped=int((~kept).sum()))
    order = [index for index in np.argsort(due_s, kind="stable").tolist() if kept[index]]
    outbox: list[Interval] = []
    began = time.monotonic()
    for index in order:
        outbox.append(walk.intervals[index])
        await asyncio.sleep(max(0.0, began + float(due_s[index]) - time.monotonic()))
        outbox = await _flush(client, server, walk, outbox, sent)
    while outbox:
        outbox = await _flush(client, server, walk, outbox, sent)
    return sent


async def _flush(
    client: httpx.AsyncClient, server: Server, walk: Walk, outbox: list[Interval], sent: Sent
) -> list[Interval]:
    """Send up to a limit of what is in the outbox, and return the rest."""
    part = outbox[:MOST_AT_ONCE]
    body = Measurements(device=walk.device, recording=walk.recording, intervals=part).model_dump_json(
        exclude_none=True
    )
    began, wait_s = time.monotonic(), 0.5
    while time.monotonic() - began < GIVE_UP_S:
        try:
            answer = await client.post(
                server.path, content=body, headers={"Content-Type": "application/json"}
            )
        except httpx.TransportError:
            sent.outcomes["tried again"] += 1
        else:
            if answer.status_code == 202:
                receipt = Receipt.model_validate_json(answer.content)
                counted = receipt.model_dump(include={"accepted", "duplicate", "late", "skewed"})
                sent.outcomes.update(counted)
                return outbox[MOST_AT_ONCE:]
            if answer.status_code in REFUSED_FOR_GOOD:
                raise server.refused(answer.status_code, answer.text)
            sent.outcomes["tried again"] += 1
            wait_s = max(wait_s, float(answer.headers.get("retry-after", 0)))
        await asyncio.sleep(wait_s)
        wait_s = min(LONGEST_WAIT_S, 2 * wait_s)
    raise server.gone()
