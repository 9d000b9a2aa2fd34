"""SIGKILL in mid-load, again and again: nothing acknowledged is lost, and filters go on from where they were.

    python soak/kills.py --kills 20

Phones send without pause and keep what was not acknowledged. After the last kill every acknowledged reading set
must be in the tracks, once, at the position that a session which never ended gives it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import sys
import tempfile
from pathlib import Path

from served_building import Building, Connection, endless, message, printed, start_server

from fploc.calibration.offsets import RangeOffsets
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import Localizer
from fploc.methods.registry import geometric_method
from fploc.serve.messages import Interval, Measurements
from fploc.serve.session import SiteSession
from fploc.serve.settings import ServeSettings

PHONES = 8
AT_ONCE = 3
RETRY_S = 0.1
PAUSE_S = 0.02
CLOSE_M = 1e-9


class Phones:
    """Phones that send without pause, and what was acknowledged of theirs."""

    def __init__(self, building: Building, port: int) -> None:
        self.building = building
        self.connections = [Connection(port, building.token("upload,read")) for _ in range(PHONES)]
        self.acknowledged: list[list[Interval]] = [[] for _ in range(PHONES)]
        self.ends = False

    async def send(self, index: int) -> None:
        """Send until it ends."""
        intervals = endless(self.building, index)
        outbox: list[Interval] = []
        while not self.ends or outbox:
            if not outbox:
                outbox = [next(intervals) for _ in range(AT_ONCE)]
            try:
                status, _ = await self.connections[index].request(
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
        status, content = await self.connections[index].request("GET", path)
        answer = json.loads(content)
        assert status == 200 and answer["is_complete"], answer
        return list(answer["points"])


def expected(building: Building, index: int, intervals: list[Interval]) -> list[tuple[float, float | None]]:
    """Return times and x of an uninterrupted session."""
    localizer = Localizer(
        geometric_method("nls-onesided"),
        building.site,
        RangeOffsets("soak", building.offset_m),
        KalmanSettings(),
    )
    session = SiteSession(localizer, ServeSettings.read("default"))
    session.restore(None, [], "phone")
    for one in intervals:
        session.ingest(Measurements(device="phone", intervals=[one]), 0.0)
    return [(fix.t_ms, fix.x_m) for outcome in session.tick() for fix in outcome.fixes]


async def run(building: Building, kills: int, seed: int) -> dict[str, object]:
    """Return what was found after so many kills."""
    chance = random.Random(seed)
    process = start_server(building)
    phones = Phones(building, process.port)
    sending = [asyncio.create_task(phones.send(index)) for index in range(PHONES)]
    for _ in range(kills):
        await asyncio.sleep(chance.uniform(0.5, 2.0))
        process.kill()
        process = await asyncio.to_thread(start_server, building, process.port)
    await asyncio.sleep(1.0)
    phones.ends = True
    await asyncio.gather(*sending)
    lost = wrong = count = 0
    for index, intervals in enumerate(phones.acknowledged):
        found = await phones.track(index)
        while len(found) < len(intervals):
            await asyncio.sleep(0.5)
            before, found = len(found), await phones.track(index)
            if len(found) == before:
                break
        by_time = {point["t_ms"]: point["x_m"] for point in found}
        count += len(intervals)
        lost += sum(one.t_ms not in by_time for one in intervals)
        wrong += sum(
            not _is_close(by_time.get(t_ms), x_m) for t_ms, x_m in expected(building, index, intervals)
        )
    process.kill()
    return {"kills": kills, "acknowledged": count, "lost": lost, "elsewhere": wrong}


def _is_close(found: object, expected_m: float | None) -> bool:
    if found is None or expected_m is None:
        return found is expected_m
    assert isinstance(found, float)
    return abs(found - expected_m) < CLOSE_M


def main() -> None:
    """Print what was found; exit with 1 where anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = asyncio.run(run(Building.make(Path(folder)), options.kills, options.seed))
    printed(found)
    sys.exit(found["lost"] != 0 or found["elsewhere"] != 0)


if __name__ == "__main__":
    main()
