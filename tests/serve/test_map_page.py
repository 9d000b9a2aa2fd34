"""The pages in a real Chromium; its screenshots are kept under runs/screenshots/."""

from __future__ import annotations

import importlib.util
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from fploc.datasets.recordings import Recording
from fploc.serve.app import make_app
from fploc.serve.messages import Measurements
from fploc.serve.recorded import recorded_intervals
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite
from fploc.serve.store import Store

_spec = importlib.util.spec_from_file_location("serving", Path(__file__).with_name("serving.py"))
assert _spec is not None and _spec.loader is not None
serving = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(serving)

SCREENSHOTS = Path(__file__).parents[2] / "runs" / "screenshots"
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
SIZE = {"width": 1200, "height": 800}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = shutil.which("chromium")
    if program is None:
        message = "no chromium: install one, for example Debian's package chromium"
        pytest.fail(message) if os.environ.get("CI") == "true" else pytest.skip(message)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that fails the test where its console says an error."""
    page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    page.set_default_timeout(60_000)
    errors: list[str] = []
    page.on("console", lambda line: errors.append(line.text) if line.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: None if "127.0.0.1" in request.url or request.url.startswith(
        ("blob:", "data:")) else errors.append(request.url))  # fmt: skip
    yield page
    page.close()
    lost = ("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET")
    assert [line for line in errors if not any(one in line for one in lost)] == []


def send(port: int, token: str, device: str, recording: Recording, site: Any) -> None:
    message = Measurements(device=device, intervals=recorded_intervals(recording, site))
    answer = httpx.post(
        f"http://127.0.0.1:{port}/v1/sites/box/measurements",
        content=message.model_dump_json(exclude_none=True),
        headers={"Authorization": f"Bearer {token}", "Content-Type": "application/json"},
        timeout=60,
    )
    assert answer.status_code == 202, answer.text


def used(port: int, t_ms: float) -> dict[str, Any]:
    """Return the position of the first device once its backlog is used up to then."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        (shown, *_) = httpx.get(f"http://127.0.0.1:{port}/v1/sites/box/positions").json()["devices"]
        if shown["t_ms"] == t_ms:
            return dict(shown)
        time.sleep(0.05)
    raise AssertionError("the backlog was not used")


def wait_for_state(page: Page, state: str) -> None:
    page.wait_for_selector(f'#connection[data-state="{state}"]')


def wait_until(page: Page, expression: str) -> None:
    """Wait from outside: the page's policy lets nobody evaluate text in it."""
    until = time.monotonic() + 60.0
    while not page.evaluate(expression):
        assert time.monotonic() < until, expression
        page.wait_for_timeout(50)


def wait_for_place(page: Page, device: str, x_m: float, y_m: float) -> list[float]:
    """Wait until a device is shown where it should be, and return where that is in the picture."""
    away = f"""(() => {{ const [u, v] = window.fplocMap.toScreen({x_m}, {y_m});
        const shown = window.fplocMap.place('{device}');
        return shown !== null && Math.hypot(u - shown[0], v - shown[1]) < 0.5; }})()"""
    wait_until(page, away)
    return page.evaluate(f"window.fplocMap.toScreen({x_m}, {y_m})")  # type: ignore[no-any-return]


def wait_for_shade(page: Page, place: list[float], fits: Callable[[int, int], bool], what: str) -> None:
    """Wait until the red and the blue of the map at a place fit."""
    until = time.monotonic() + 60.0
    while True:
        red, _, blue = shade(page, place)
        if fits(red, blue):
            return
        assert time.monotonic() < until, f"{what}: red {red}, blue {blue}"
        page.wait_for_timeout(50)


def shade(page: Page, place: list[float]) -> list[int]:
    """Return the colour of the map at a place, red, green, blue."""
    script = """([u, v]) => { const c = document.getElementById('map');
        return [...c.getContext('2d').getImageData(Math.round(u), Math.round(v), 1, 1).data].slice(0, 3); }"""
    return page.evaluate(script, place)  # type: ignore[no-any-return]


def shoot(page: Page, name: str) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png")


def test_dots_stand_where_they_should_and_a_lost_connection_mends_itself(
    page: Page, served: ServedSite, store: Store, settings: ServeSettings, recordings: list[Recording],
    token_of: Callable[..., str],
) -> None:  # fmt: skip
    token, site = token_of("upload,read"), served.localizer.site
    opened = replace(settings, is_read_anonymous=True, silent_ms=1e9)
    with serving.running(make_app([served], store, opened)) as port:
        send(port, token, "a", recordings[0], site)
        page.goto(f"http://127.0.0.1:{port}/")
        wait_for_state(page, "live")
        wait_until(page, "window.fplocMap.place('a') !== null")
        wait_until(page, "document.querySelector('#devices .where')?.textContent.includes(',')")
        shown = used(port, 1000.0 * float(recordings[0].t_s[-1]))
        # The list of errors comes late and takes room from the map: dots move in the picture.
        page.wait_for_selector("#error-section:not([hidden])")
        place = wait_for_place(page, "a", shown["x_m"], shown["y_m"])
        # The whole plan is in view, metres up: the corner AP2 at (20, 15) is right of and above AP0 at (0, 0).
        first, third = (page.evaluate(f"window.fplocMap.toScreen({x}, {y})") for x, y in ((0, 0), (20, 15)))
        assert 0 < first[0] < third[0] < SIZE["width"] and 0 < third[1] < first[1] < SIZE["height"]
        wait_for_shade(page, place, lambda red, blue: blue > 120 > red, "a device is drawn blue")
        wait_for_shade(page, first, lambda red, blue: red > 120 > blue, "an access point is drawn orange")
        assert "RMSE" in page.inner_text("#error-text")
        page.get_by_role("button", name="a ").first.press("Enter")
        page.wait_for_selector("#panel-readings tr")
        assert "95 % ellipse" in page.inner_text("#panel-values")
        assert "nls-onesided, for people at 0.5 m/s" in page.inner_text("#panel-values")
        shoot(page, "map-light")
        page.emulate_media(color_scheme="dark")
        wait_for_shade(page, [1.0, SIZE["height"] / 2], lambda red, _: red < 120, "the ground is dark")
        shoot(page, "map-dark")
    wait_for_state(page, "lost")
    with serving.running(make_app([served], store, opened), port):
        wait_for_state(page, "live")
        send(port, token, "b", recordings[1], site)
        wait_until(page, "window.fplocMap.place('b') !== null")
        assert page.evaluate("window.fplocMap.devices()") == ["a", "b"]


def test_the_map_asks_for_a_token_and_works_by_keyboard(
    page: Page, served: ServedSite, store: Store, settings: ServeSettings, token_of: Callable[..., str]
) -> None:
    with serving.running(make_app([served], store, settings)) as port:
        page.goto(f"http://127.0.0.1:{port}/healthz")
        page.evaluate(f"sessionStorage.setItem('fploc-token', '{token_of('read')}')")
        page.goto(f"http://127.0.0.1:{port}/")
        wait_for_state(page, "live")
        before = page.evaluate("window.fplocMap.toScreen(0, 0)")
        page.focus("#map")
        page.keyboard.press("ArrowRight")
        assert page.evaluate("window.fplocMap.toScreen(0, 0)")[0] == pytest.approx(before[0] - 60)
        page.keyboard.press("0")
        assert page.evaluate("window.fplocMap.toScreen(0, 0)") == pytest.approx(before)
        assert page.inner_text("#scale-text").endswith(" m")


def test_the_page_of_the_api_draws_itself(
    page: Page, served: ServedSite, store: Store, settings: ServeSettings
) -> None:
    with serving.running(make_app([served], store, settings)) as port:
        page.goto(f"http://127.0.0.1:{port}/docs")
        page.get_by_text("/v1/sites/{site}/measurements").first.wait_for()
        shoot(page, "docs")
