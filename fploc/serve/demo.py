"""A made-up building, a server, four simulated phones: ``make demo``."""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.serve.app import make_app
from fploc.serve.models import ModelRequest, served_site
from fploc.serve.phones import Conditions, Server, Walk, send_walks
from fploc.serve.recorded import recorded_intervals
from fploc.serve.server import announcement, listening_socket, server_of
from fploc.serve.settings import ServeSettings
from fploc.serve.store import Store, sqlite_url
from fploc.serve.tokens import Scope, make_token
from fploc.shipped import DEFAULT
from fploc.sites.made_up import LINE_OF_SIGHT_OFFSET_M, made_up_site

SEED = 7
LAPS = 2
LAP_S = 300.0
PACE = 3.0
"""The made-up walks are as slow as the robots of the measured laps."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the demo until it is interrupted."""
    parser = argparse.ArgumentParser(description="A made-up building with four simulated phones on a map.")
    parser.add_argument("--folder", type=Path, default=Path("runs/demo"), help="Folder to write.")
    parser.add_argument("--port", type=int, default=8000, help="0 takes a free one.")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="End after so long.")
    options = parser.parse_args(arguments)
    try:
        asyncio.run(asyncio.wait_for(_demo(options.folder, options.port), options.seconds))
    except (TimeoutError, KeyboardInterrupt):
        return


async def _demo(folder: Path, port: int) -> None:
    name = f"made-up-{SEED}"
    if not (folder / "packed" / name).is_dir():
        build_sites(None, folder, [made_up_site(SEED, folder / "files", laps=LAPS, duration_s=LAP_S)])
    settings = ServeSettings.read("demo")
    offset, speed_mps = str(LINE_OF_SIGHT_OFFSET_M), settings.speed_prior_mps
    request = ModelRequest(DEFAULT, offset, speed_mps, "default", 0, folder)
    site = served_site(folder, name, request)
    store = Store(sqlite_url(folder / "state"))
    token = make_token(store, "demo phones", frozenset({Scope.UPLOAD}), days=1.0, now_ms=time.time() * 1000.0)
    with listening_socket("127.0.0.1", port) as listening:
        server = server_of(make_app([site], store, settings), listening)
        print(announcement([site], listening), file=sys.stderr, flush=True)  # noqa: T201
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        print(f"Open {url} in a browser; Ctrl-C ends it.", flush=True)  # noqa: T201
        serving = asyncio.create_task(server.serve())
        walking = asyncio.create_task(_walk(folder, name, Server(url, name, token)))
        try:
            await asyncio.wait({serving, walking}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            walking.cancel()
            server.should_exit = True
            await asyncio.gather(serving, walking, return_exceptions=True)
            store.close()


async def _walk(folder: Path, name: str, server: Server) -> None:
    """Let four phones walk their laps, again and again."""
    packed = read_packed(folder, name)
    laps = [(lap, recorded_intervals(lap, packed.site)) for lap in packed.recordings()]
    while True:
        began = f"{time.time():.0f}"
        walks = [
            Walk(f"phone-{index + 1}", f"{lap.name}-{began}", intervals)
            for index, (lap, intervals) in enumerate(laps)
        ]
        await send_walks(server, walks, Conditions(speed=PACE))


if __name__ == "__main__":
    main()
