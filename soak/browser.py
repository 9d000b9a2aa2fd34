"""The map page in Chromium while many phones send: how much of a core its renderer takes.

    python soak/browser.py --devices 200 --seconds 30 --out runs/soak/browser.json

Phones send once a second, which leaves the machine room for the browser; the page draws all of them at each tick.
Everything is on: trails, ellipses, ground truth, error and its distribution, one device selected. Chromium draws
without a graphics card here, so that its processor does what a card would do.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path

from load import Observed, counters, phone
from playwright.async_api import Browser, async_playwright
from served_building import CHEAP_METHOD, Building, Connection, ServerProcess, printed, server, written

SIZE = {"width": 1920, "height": 1080}
FLAGS = ["--no-sandbox", "--disable-gpu"]
SENT_EVERY_S = 1.0
WARM_UP_S = 25.0
"""Trails are 20 s long."""


async def cpu_s(browser: Browser) -> Counter[str]:
    """Return the processor time that each kind of the browser's processes has used, seconds."""
    session = await browser.new_browser_cdp_session()
    answer = await session.send("SystemInfo.getProcessInfo")
    await session.detach()
    used: Counter[str] = Counter()
    for one in answer["processInfo"]:
        used[one["type"]] += one["cpuTime"]
    return used


async def ticks_of(process: ServerProcess, token: str) -> float:
    """Return how often the server has ticked."""
    connection = Connection(process.port, token)
    counted = await counters(connection)
    connection.close()
    return counted["fploc_ticks_total"]


async def measure(
    building: Building, process: ServerProcess, devices: int, seconds: float, screenshot: Path | None
) -> dict[str, object]:
    """Return what the browser used while the phones sent."""
    tokens, reader = [building.token("upload") for _ in range(devices)], building.token("read")
    times = (time.monotonic(), time.monotonic() + WARM_UP_S + seconds + 20.0)
    sending = [
        asyncio.create_task(
            phone(process.port, token, building, index, times, Observed(), period_s=SENT_EVERY_S)
        )
        for index, token in enumerate(tokens)
    ]
    url = f"http://127.0.0.1:{process.port}"
    async with async_playwright() as playwright:
        program = shutil.which("chromium")
        assert program is not None, "install chromium, for example Debian's package chromium"
        browser = await playwright.chromium.launch(executable_path=program, args=FLAGS)
        page = await browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
        await page.goto(f"{url}/healthz")
        await page.evaluate(f"sessionStorage.setItem('fploc-token', '{reader}')")
        await page.goto(f"{url}/")
        await page.wait_for_selector(f"#devices li:nth-child({devices})", timeout=60_000)
        await page.locator("#devices button").first.click()
        await asyncio.sleep(WARM_UP_S)
        used, ticks, began = await cpu_s(browser), await ticks_of(process, reader), time.monotonic()
        await asyncio.sleep(seconds)
        spent, took_s = await cpu_s(browser) - used, time.monotonic() - began
        ticks = await ticks_of(process, reader) - ticks
        if screenshot is not None:
            await page.screenshot(path=screenshot)
        await browser.close()
    for task in sending:
        task.cancel()
    await asyncio.gather(*sending, return_exceptions=True)
    return {
        "devices": devices,
        "seconds": seconds,
        "ticks_per_s": round(ticks / took_s, 2),
        "size": f"{SIZE['width']} × {SIZE['height']}",
        "renderer_cores": round(spent["renderer"] / took_s, 3),
        "all_processes_cores": round(spent.total() / took_s, 3),
    }


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--devices", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--out", type=Path, help="File to write it to.")
    parser.add_argument("--screenshot", type=Path, help="Picture to write.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        building = Building.make(Path(folder))
        with server(building, CHEAP_METHOD) as process:
            found = asyncio.run(
                measure(building, process, options.devices, options.seconds, options.screenshot)
            )
    printed(found)
    if options.out is not None:
        written(options.out, found)


if __name__ == "__main__":
    main()
