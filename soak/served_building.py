"""A made-up building, a server of it in a process of its own, and phones that send as fast as they can.

The phones speak HTTP/1.1 over connections that stay open, by hand: a client that costs more than the server
would measure itself.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.datasets.recordings import Recording
from fploc.serve.messages import Interval, Measurements
from fploc.serve.recorded import recorded_intervals
from fploc.serve.store import Store, sqlite_url
from fploc.serve.tokens import make_token, scopes_of
from fploc.sites.made_up import LINE_OF_SIGHT_OFFSET_M, made_up_site
from fploc.sites.site import Site

SEED = 7
CHEAP_METHOD = "nls-onesided"
"""For what is not about the method: its fixes cost little."""
PERIOD_S = 0.2
STARTS_WITHIN_S = 240.0
POLL_S = 0.05


@dataclass(frozen=True)
class Building:
    """A packed made-up building below a folder, and its recordings."""

    folder: Path
    site: Site
    recordings: list[Recording]

    @classmethod
    def make(cls, folder: Path) -> Building:
        """Write and pack it."""
        build_sites(None, folder, [made_up_site(SEED, folder / "files", laps=1, duration_s=300.0)])
        packed = read_packed(folder, f"made-up-{SEED}")
        return cls(folder, packed.site, packed.recordings())

    @cached_property
    def laps(self) -> list[list[Interval]]:
        """What a phone sends in each recording: every access point of the building in every reading set."""
        return [recorded_intervals(_complete(recording), self.site) for recording in self.recordings]

    @property
    def offset_m(self) -> float:
        """Removed from every range."""
        return LINE_OF_SIGHT_OFFSET_M

    @property
    def database(self) -> str:
        """URL of the server's database."""
        return sqlite_url(self.folder / "state")

    def token(self, scopes: str) -> str:
        """Return a new token."""
        store = Store(self.database)
        try:
            return make_token(store, "soak", scopes_of(scopes), 1.0, time.time() * 1000.0)
        finally:
            store.close()


def _complete(recording: Recording) -> Recording:
    """Return a recording where access points that do not answer repeat what they said last."""
    heard = recording.heard

    def held(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return pd.DataFrame(np.where(heard, values, np.nan)).ffill().bfill().fillna(0.0).to_numpy()

    return replace(
        recording,
        slant_m=held(recording.slant_m),
        std_m=held(recording.std_m),
        rss_dbm=held(recording.rss_dbm),
        heard=np.broadcast_to(heard.any(axis=0), heard.shape),
    )


@dataclass
class ServerProcess:
    """A server in a process of its own."""

    process: subprocess.Popen[bytes]
    port: int

    def kill(self) -> None:
        """End it at once: SIGKILL."""
        self.process.kill()
        self.process.wait()


def start_server(building: Building, method: str, port: int = 0) -> ServerProcess:
    """Start a server of the building with a method and return once it listens."""
    command = [
        sys.executable, "-m", "fploc", "serve", "--site", building.site.name, "--model", method,
        "--data-root", str(building.folder), "--calibration", str(building.offset_m),
        "--database", building.database, "--port", str(port),
    ]  # fmt: skip
    # Into a file: a pipe that nobody empties would stop the server sooner or later.
    log = building.folder / "server.log"
    with log.open("wb") as errors:
        process = subprocess.Popen(command, stderr=errors)
    until = time.monotonic() + STARTS_WITHIN_S
    while time.monotonic() < until and process.poll() is None:
        found = re.search(r"http://127\.0\.0\.1:(\d+)", log.read_text())
        if found is not None:
            # It listens before it answers: what comes meanwhile waits.
            with urllib.request.urlopen(f"{found[0]}/readyz", timeout=STARTS_WITHIN_S):
                return ServerProcess(process, int(found[1]))
        time.sleep(POLL_S)
    process.kill()
    raise RuntimeError(f"the server did not start: {log.read_text()}")


def memory_mb_of(server: ServerProcess) -> float:
    """Return the resident memory of a server, megabytes."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{server.process.pid}/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def cpu_s_of(server: ServerProcess) -> float:
    """Return the processor time that a server has used, seconds."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def server(building: Building, method: str) -> Iterator[ServerProcess]:
    """Yield a server that ends with the block."""
    started = start_server(building, method)
    try:
        yield started
    finally:
        started.kill()


class Connection:
    """One connection that stays open."""

    def __init__(self, port: int, token: str) -> None:
        self._port, self._token = port, token
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def request(self, method: str, path: str, body: bytes = b"") -> tuple[int, str, bytes]:
        """Send a request and return status, head and body of the answer."""
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self._port)
        reader, writer = self._streams
        head = (
            f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {self._token}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
        )
        try:
            writer.write(head.encode() + body)
            answer = (await reader.readuntil(b"\r\n\r\n")).decode()
            length = re.search(r"content-length: (\d+)", answer, re.IGNORECASE)
            content = await reader.readexactly(int(length[1]) if length else 0)
        except (OSError, EOFError):
            self.close()
            raise
        return int(answer.split(" ", 2)[1]), answer, content

    def close(self) -> None:
        """Close it; the next request opens it again."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


def endless(building: Building, phone: int) -> Iterator[Interval]:
    """Yield intervals of a lap, there and back again and again, five a second by the phone's clock: nobody leaps."""
    lap = building.laps[phone % len(building.laps)]
    intervals = [*lap, *lap[-2:0:-1]]
    index = 7 * phone
    t_ms = 0.0
    while True:
        yield intervals[index % len(intervals)].model_copy(update={"t_ms": t_ms})
        index += 1
        t_ms += 1000.0 * PERIOD_S


def message(device: str, intervals: list[Interval]) -> bytes:
    """Return the body of a request."""
    return Measurements(device=device, intervals=intervals).model_dump_json(exclude_none=True).encode()


def printed(values: dict[str, object]) -> None:
    """Print one line of JSON."""
    print(json.dumps(values), flush=True)  # noqa: T201


def written(path: Path, found: object) -> None:
    """Write what was found as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
