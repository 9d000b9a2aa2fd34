"""Phones at 5 Hz against a server on the same machine: how soon fixes are out, what memory does, what is shed.

    python soak/load.py --devices 50 --seconds 300
    python soak/load.py --devices 10,50,100,200,400 --seconds 60

One line of JSON for each number of devices. A fix is out when a live connection has its position; its latency
is counted from when its tick was due.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from served_building import (
    PERIOD_S,
    Building,
    Connection,
    ServerProcess,
    endless,
    message,
    printed,
    server,
)
from websockets.asyncio.client import connect

SETTLING_S = 60.0
DEADLINE_S = 0.2


async def phone(port: int, token: str, building: Building, index: int, until: float) -> Counter[str]:
    """Send an interval every 200 ms until then; what is refused is lost, as on a phone without a memory."""
    counts: Counter[str] = Counter()
    connection = Connection(port, token)
    intervals = endless(building, index)
    due = time.monotonic() + PERIOD_S * index / 50.0 % PERIOD_S
    while (now := time.monotonic()) < until:
        await asyncio.sleep(max(0.0, due - now))
        due = max(due + PERIOD_S, time.monotonic() - 10 * PERIOD_S)
        status, _ = await connection.request(
            "POST",
            f"/v1/sites/{building.site.name}/measurements",
            message(f"phone-{index}", [next(intervals)]),
        )
        counts[str(status)] += 1
    connection.close()
    return counts


async def listen(
    port: int, token: str, building: Building, latencies_s: list[float], connected: asyncio.Event
) -> None:
    """Note for every fix how long after its tick was due it came out."""
    latest: dict[str, float] = {}
    address = f"ws://127.0.0.1:{port}/v1/sites/{building.site.name}/live"
    async with connect(
        address, additional_headers={"Authorization": f"Bearer {token}"}, max_size=None
    ) as live:
        async for text in live:
            came_ms = time.time() * 1000.0
            tick = json.loads(text)
            for device in tick["devices"]:
                if latest.get(device["device"]) != device["t_ms"]:
                    latest[device["device"]] = device["t_ms"]
                    latencies_s.append((came_ms - tick["server_ms"]) / 1000.0)


async def watch(process: ServerProcess, memory_mb: list[tuple[float, float]]) -> None:
    """Note the server's memory each second."""
    while True:
        memory_mb.append((time.monotonic(), process.memory_mb()))
        await asyncio.sleep(1.0)


async def load(building: Building, process: ServerProcess, devices: int, seconds: float) -> dict[str, object]:
    """Return what came out under load."""
    tokens = [building.token("upload") for _ in range(devices)]
    latencies_s: list[float] = []
    memory_mb: list[tuple[float, float]] = []
    reader = building.token("read")
    connected = asyncio.Event()
    background = [
        asyncio.create_task(listen(process.port, reader, building, latencies_s, connected)),
        asyncio.create_task(watch(process, memory_mb)),
    ]
    await asyncio.wait(
        {background[0], asyncio.create_task(connected.wait())}, return_when=asyncio.FIRST_COMPLETED
    )
    if background[0].done():
        await background[0]
    began, cpu_s = time.monotonic(), process.cpu_s()
    phones = [
        phone(process.port, token, building, index, began + seconds) for index, token in enumerate(tokens)
    ]
    counts = sum(await asyncio.gather(*phones), Counter[str]())
    used_s = process.cpu_s() - cpu_s
    for task in background:
        task.cancel()
    await asyncio.gather(*background, return_exceptions=True)
    settled = [megabytes for at, megabytes in memory_mb if at - began >= min(SETTLING_S, seconds / 2)]
    return {
        "devices": devices,
        "seconds": seconds,
        "answers": dict(counts),
        "wanted": round(devices * seconds / PERIOD_S),
        "fixes": len(latencies_s),
        "within_200_ms": round(float(np.mean(np.array(latencies_s) <= DEADLINE_S)), 5),
        "p50_ms": round(1000 * float(np.percentile(latencies_s, 50)), 1),
        "p99_ms": round(1000 * float(np.percentile(latencies_s, 99)), 1),
        "server_cores": round(used_s / seconds, 2),
        "memory_mb": round(settled[-1], 1),
        "memory_growth": round(settled[-1] / settled[0] - 1, 4),
    }


def main() -> None:
    """Measure each number of devices with a server of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--devices", default="50", help="Numbers, commas between.")
    parser.add_argument("--seconds", type=float, default=300.0)
    options = parser.parse_args()
    for devices in map(int, options.devices.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            building = Building.make(Path(folder))
            with server(building) as process:
                printed(asyncio.run(load(building, process, devices, options.seconds)))


if __name__ == "__main__":
    main()
