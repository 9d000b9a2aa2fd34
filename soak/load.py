"""Phones at 5 Hz against a server on the same machine: how soon fixes are out, what memory does, what is shed.

    python soak/load.py --devices 50 --seconds 300 --out runs/soak/steady-default.json
    python soak/load.py --devices 10,25,50,100,200,400 --seconds 30

One line of JSON for each number of devices; each gets a server of its own, just started. A phone keeps what was
not acknowledged and sends it with what came since, as docs/phone.md asks. A fix is out when a live connection has
its position: its latency is counted from when its tick was due, its age from when the phone measured it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import uvloop
from numpy.typing import NDArray
from served_building import (
    CHEAP_METHOD,
    PERIOD_S,
    Building,
    Connection,
    ServerProcess,
    cpu_s_of,
    endless,
    memory_mb_of,
    message,
    printed,
    server,
    written,
)
from websockets.asyncio.client import connect

from fploc.serve.messages import Interval
from fploc.shipped import DEFAULT

WARM_UP_S = 5.0
"""At the beginning, not counted: the first tick compiles and allocates."""
SETTLING_S = 60.0
DEADLINE_S = 0.2
MOST_AT_ONCE = 20
LONGEST_DRAIN_S = 10.0


@dataclass
class Observed:
    """What was seen from outside while the phones sent.

    Args:
        measured_s: When a phone measured a reading set, by device and its clock.
        latencies_s: From when a tick was due until a fix of it was seen.
        ages_s: From when a reading set was measured until its fix was seen.
        answers: Of the server, by status.
        accepted: Reading sets that were acknowledged, by device.
        fixes: Reading sets whose fix was seen, by device.
        ticks: Seen, and how many of them said that the server is overloaded.
        waiting: Reading sets that waited in the server, each second.
        memory_mb: Of the server, each second since the beginning.
    """

    measured_s: dict[tuple[str, float], float] = field(default_factory=dict)
    latencies_s: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    fixes: Counter[str] = field(default_factory=Counter)
    ticks: Counter[bool] = field(default_factory=Counter)
    waiting: list[float] = field(default_factory=list)
    memory_mb: list[tuple[float, float]] = field(default_factory=list)


async def phone(
    port: int,
    token: str,
    building: Building,
    index: int,
    times: tuple[float, float],
    seen: Observed,
    *,
    period_s: float = PERIOD_S,
) -> None:
    """Measure at a rate from one time to another, and send what is not acknowledged yet."""
    began, until = times
    connection = Connection(port, token)
    intervals, outbox = endless(building, index), list[Interval]()
    device = f"phone-{index}"
    due = began + period_s * (index * 0.618034 % 1.0)
    not_before = due
    while due < until or (outbox and time.monotonic() < until + LONGEST_DRAIN_S):
        await asyncio.sleep(max(0.0, min(due, until) - time.monotonic(), not_before - time.monotonic()))
        while due <= time.monotonic() and due < until:
            outbox.append(next(intervals))
            if due >= began + WARM_UP_S:
                seen.measured_s[device, outbox[-1].t_ms] = due
            due += period_s
        if not outbox:
            continue
        part = outbox[:MOST_AT_ONCE]
        path = f"/v1/sites/{building.site.name}/measurements"
        status, head, _ = await connection.request("POST", path, message(device, part))
        seen.answers[str(status)] += 1
        if status == 202:
            del outbox[: len(part)]
            seen.accepted[device] += len(part)
        else:
            wait = re.search(r"retry-after: (\d+)", head, re.IGNORECASE)
            not_before = time.monotonic() + (float(wait[1]) if wait else 1.0)
    connection.close()


async def listen(
    port: int, token: str, building: Building, seen: Observed, is_connected: asyncio.Event
) -> None:
    """Note for every fix when it came out."""
    latest: dict[str, float] = {}
    address = f"ws://127.0.0.1:{port}/v1/sites/{building.site.name}/live"
    async with connect(
        address, additional_headers={"Authorization": f"Bearer {token}"}, max_size=None
    ) as live:
        is_connected.set()
        async for text in live:
            came_ms, came_s = time.time() * 1000.0, time.monotonic()
            tick = json.loads(text)
            seen.ticks[tick["is_overloaded"]] += 1
            for one in tick["devices"]:
                name, t_ms = one["device"], one["t_ms"]
                if latest.get(name) == t_ms:
                    continue
                latest[name] = t_ms
                measured_s = seen.measured_s.get((name, t_ms))
                if measured_s is not None:
                    seen.fixes[name] += 1
                    seen.latencies_s.append((came_ms - tick["server_ms"]) / 1000.0)
                    seen.ages_s.append(came_s - measured_s)


async def watch(process: ServerProcess, token: str, began: float, seen: Observed) -> None:
    """Note the server's memory and queue each second."""
    connection = Connection(process.port, token)
    while True:
        seen.memory_mb.append((time.monotonic() - began, memory_mb_of(process)))
        seen.waiting.append((await counters(connection))["fploc_waiting"])
        await asyncio.sleep(1.0)


async def counters(connection: Connection) -> dict[str, float]:
    """Return what the server counts, summed over labels; refusals by their reason."""
    _, _, content = await connection.request("GET", "/metrics")
    found: dict[str, float] = defaultdict(float)
    for name, labels, value in re.findall(r"^(\w+)(\{.*\})? (\S+)$", content.decode(), re.MULTILINE):
        found[name] += float(value)
        if reason := re.search(r'reason="(\w+)"', labels):
            found[f"{name} {reason[1]}"] += float(value)
    return found


async def drained(connection: Connection) -> dict[str, float]:
    """Return what the server counts once nothing waits, or after a while."""
    until = time.monotonic() + LONGEST_DRAIN_S
    while True:
        await asyncio.sleep(2 * PERIOD_S)
        counted = await counters(connection)
        if counted["fploc_waiting"] == 0.0 or time.monotonic() > until:
            return counted


async def load(building: Building, process: ServerProcess, devices: int, seconds: float) -> dict[str, object]:
    """Return what came out under load."""
    tokens = [building.token("upload") for _ in range(devices)]
    reader, seen, is_connected = building.token("read"), Observed(), asyncio.Event()
    listening = asyncio.create_task(listen(process.port, reader, building, seen, is_connected))
    connected = asyncio.create_task(is_connected.wait())
    await asyncio.wait({listening, connected}, return_when=asyncio.FIRST_COMPLETED)
    began, cpu_s = time.monotonic(), cpu_s_of(process)
    watching = asyncio.create_task(watch(process, reader, began, seen))
    phones = asyncio.gather(
        *(
            phone(process.port, token, building, index, (began, began + seconds), seen)
            for index, token in enumerate(tokens)
        )
    )
    # The listener and the watcher end with an error or not at all.
    await asyncio.wait({phones, listening, watching}, return_when=asyncio.FIRST_COMPLETED)
    for task in (listening, watching):
        if task.done():
            phones.cancel()
            task.result()
    await phones
    took_s, used_s = time.monotonic() - began, cpu_s_of(process) - cpu_s
    counted = await drained(Connection(process.port, reader))
    for task in (listening, watching):
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
    return {
        "devices": devices,
        "seconds": seconds,
        **summary(seen, seconds, devices),
        "waiting_at_the_end": int(counted["fploc_waiting"]),
        "fixes_made": int(counted["fploc_fixes_total"]),
        "server_cores": round(used_s / took_s, 2),
        "missed_ticks": int(counted["fploc_missed_ticks_total"]),
        "refused": {
            name.rpartition(" ")[2]: int(value)
            for name, value in counted.items()
            if name.startswith("fploc_messages_rejected_total ")
        },
    }


def summary(seen: Observed, seconds: float, devices: int) -> dict[str, object]:
    """Return what was seen as numbers."""
    settled = [megabytes for at, megabytes in seen.memory_mb if at >= min(SETTLING_S, seconds / 2)]
    latencies_ms, ages_ms = (1000.0 * np.array(values) for values in (seen.latencies_s, seen.ages_s))
    return {
        "measured": len(seen.measured_s),
        "accepted": seen.accepted.total(),
        "accepted_of_least_and_most": _least_and_most(seen.accepted, devices),
        "accepted_fairness": fairness(seen.accepted, devices),
        "answers": dict(sorted(seen.answers.items())),
        "fixes_seen": len(latencies_ms),
        "fixes_seen_of_least_and_most": _least_and_most(seen.fixes, devices),
        "fixes_seen_fairness": fairness(seen.fixes, devices),
        "within_200_ms": round(float(np.mean(latencies_ms <= 1000.0 * DEADLINE_S)), 5),
        "latency_p50_ms": _percentile(latencies_ms, 50),
        "latency_p99_ms": _percentile(latencies_ms, 99),
        "age_p50_ms": _percentile(ages_ms, 50),
        "age_p99_ms": _percentile(ages_ms, 99),
        "overloaded_ticks": round(seen.ticks[True] / max(1, seen.ticks.total()), 3),
        "most_waiting": int(max(seen.waiting)),
        "memory_mb": round(settled[-1], 1),
        "memory_growth": round(settled[-1] / settled[0] - 1, 4),
    }


def fairness(counts: Counter[str], devices: int) -> float:
    """Return Jain's index of the phones' shares: 1 where all got the same, 1/n where one got everything.

    Source: Jain, Chiu, Hawe, DEC-TR-301, 1984.
    """
    shares = np.array([counts[f"phone-{index}"] for index in range(devices)], dtype=np.float64)
    squares = float(np.square(shares).sum())
    return round(float(shares.sum()) ** 2 / (devices * squares), 4) if squares else 0.0


def _least_and_most(counts: Counter[str], devices: int) -> list[int]:
    shares = [counts[f"phone-{index}"] for index in range(devices)]
    return [min(shares), max(shares)]


def _percentile(values: NDArray[np.float64], share: float) -> float:
    return round(float(np.percentile(values, share)), 1)


def main() -> None:
    """Measure each number of devices with a server of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--devices", default="50", help="Numbers, commas between.")
    parser.add_argument("--method", choices=(DEFAULT, CHEAP_METHOD), default=DEFAULT, help="That is served.")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--out", type=Path, help="File to write all of it to.")
    options = parser.parse_args()
    found = []
    for devices in map(int, options.devices.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            building = Building.make(Path(folder))
            with server(building, options.method) as process:
                seen = uvloop.run(load(building, process, devices, options.seconds))
        found.append({"method": options.method, **seen})
        printed(found[-1])
        if options.out is not None:
            written(options.out, found)


if __name__ == "__main__":
    main()
