"""SIGKILL in mid-load, again and again: nothing acknowledged is lost, and filters go on from where they were.

    python soak/kills.py --kills 20

Phones send without pause and keep what was not acknowledged. After the last kill every acknowledged reading set
must be in the tracks, once, at the position that a session which never ended gives it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import random
import sys
import tempfile
import time
from pathlib import Path

import uvloop
from served_building import (
    CHEAP_METHOD,
    Building,
    Connection,
    endless,
    message,
    printed,
    start_server,
    written,
)

from fploc.serve.messages import Interval, Measurements
from fploc.serve.models import ModelRequest, served_site
from fploc.serve.session import SiteSession
from fploc.serve.settings import ServeSettings
from fploc.shipped import DEFAULT

PHONES = 8
AT_ONCE = 3
RETRY_S = 0.1
PAUSE_S = 0.02
CLOSE_M = 1e-5
"""With other devices in the batch, solvers that stop where the cost is flat to its last digit are up to 1e-8 m
elsewhere, beliefs in single precision 1e-6 m."""
BETWEEN_KILLS = 30
"""Reading sets that are acknowledged, at the least, between two kills: each kill falls into the load."""
LONGEST_RUN_S = 1.5
PATIENCE_S = 120.0


class Phones:
    """Phones that send without pause, and what was acknowledged of theirs."""

    def __init__(self, building: Building, port: int) -> None:
        self.building = building
        self.connections = [Connection(port, building.token("upload,read")) for _ in range(PHONES)]
        self.acknowledged: list[list[Interval]] = [[] for _ in range(PHONES)]
        self.ends = False

    @property
    def count(self) -> int:
        """Reading sets that were acknowledged."""
        return sum(map(len, self.acknowledged))

    async def wait_for(self, more: int) -> None:
        """Return once so many more are acknowledged."""
        wanted, until = self.count + more, time.monotonic() + PATIENCE_S
        while self.count < wanted:
            assert time.monotonic() < until, "the server takes nothing in"
            await asyncio.sleep(PAUSE_S)

    async def send(self, index: int) -> None:
        """Send until it ends."""
        intervals = endless(self.building, index)
        outbox: list[Interval] = []
        while not self.ends or outbox:
            if not outbox:
                outbox = [next(intervals) for _ in range(AT_ONCE)]
            try:
                status, _, _ = await self.connections[index].request(
                    "POST",
                    f"/v1/sites/{self.building.site.name}/measurements",
                    message(f"phone-{index}", outbox),
                )
            except (OSError, EOFError):
                await asyncio.sleep(RETRY_S)
                continue
            if status == 202:
                self.acknowledged[index] += outbox
                outbox = []
                await asyncio.sleep(PAUSE_S)
            else:
                await asyncio.sleep(RETRY_S)

    async def track(self, index: int) -> list[dict[str, object]]:
        """Return the stored track of a phone."""
        path = f"/v1/sites/{self.building.site.name}/devices/phone-{index}/track"
        status, _, content = await self.connections[index].request("GET", path)
        answer = json.loads(content)
        assert status == 200 and answer["is_complete"], answer
        return list(answer["points"])

    async def whole_track(self, index: int) -> list[dict[str, object]]:
        """Return the track of a phone with all that was acknowledged, or what there is when no more comes."""
        found, until = await self.track(index), time.monotonic() + PATIENCE_S
        while len(found) < len(self.acknowledged[index]) and time.monotonic() < until:
            await asyncio.sleep(RETRY_S)
            before, found = len(found), await self.track(index)
            if len(found) > before:
                until = time.monotonic() + PATIENCE_S
        return found


def expected(building: Building, method: str, intervals: list[Interval]) -> list[tuple[float, float | None]]:
    """Return times and x of an uninterrupted session."""
    settings = ServeSettings.read("default")
    offset, speed_mps = str(building.offset_m), settings.speed_prior_mps
    request = ModelRequest(method, offset, speed_mps, "default", 0, building.folder)
    served = served_site(building.folder, building.site.name, request)
    session = SiteSession(served.localizer, settings)
    session.restore(None, None, [], "phone")
    for one in intervals:
        session.ingest(Measurements(device="phone", intervals=[one]), 0.0)
    return [(fix.t_ms, fix.x_m) for outcome in session.tick() for fix in outcome.fixes]


async def run(building: Building, method: str, kills: int, seed: int) -> dict[str, object]:
    """Return what was found after so many kills."""
    chance = random.Random(seed)
    process = start_server(building, method)
    try:
        phones = Phones(building, process.port)
        sending = [asyncio.create_task(phones.send(index)) for index in range(PHONES)]
        for _ in range(kills):
            await phones.wait_for(BETWEEN_KILLS)
            await asyncio.sleep(chance.uniform(0.0, LONGEST_RUN_S))
            process.kill()
            process = await asyncio.to_thread(start_server, building, method, process.port)
        await phones.wait_for(BETWEEN_KILLS)
        phones.ends = True
        await asyncio.gather(*sending)
        return {"method": method, "kills": kills, **await compared(building, method, phones)}
    finally:
        process.kill()


async def compared(building: Building, method: str, phones: Phones) -> dict[str, object]:
    """Return how much of what was acknowledged is missing, and how much is elsewhere than it should be."""
    lost = elsewhere = 0
    farthest_m = 0.0
    tracks = [await phones.whole_track(index) for index in range(PHONES)]
    for track, intervals in zip(tracks, phones.acknowledged, strict=True):
        found = {point["t_ms"]: point["x_m"] for point in track}
        lost += sum(one.t_ms not in found for one in intervals)
        away_m = [_away_m(found.get(t_ms), x_m) for t_ms, x_m in expected(building, method, intervals)]
        elsewhere += sum(one > CLOSE_M for one in away_m)
        farthest_m = max([farthest_m, *(one for one in away_m if math.isfinite(one))])
    return {"acknowledged": phones.count, "lost": lost, "elsewhere": elsewhere, "farthest_m": farthest_m}


def _away_m(found: object, expected_m: float | None) -> float:
    """Return how far a position is from where it is expected; infinity where only one of them is there."""
    if found is None or expected_m is None:
        return 0.0 if found is expected_m else math.inf
    assert isinstance(found, float)
    return abs(found - expected_m)


def main() -> None:
    """Print what was found; exit with 1 where anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--method", choices=(DEFAULT, CHEAP_METHOD), default=CHEAP_METHOD, help="That is served."
    )
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="File to write it to.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = uvloop.run(run(Building.make(Path(folder)), options.method, options.kills, options.seed))
    printed(found)
    if options.out is not None:
        written(options.out, found)
    sys.exit(found["lost"] != 0 or found["elsewhere"] != 0)


if __name__ == "__main__":
    main()
