from __future__ import annotations

import asyncio
import importlib.util
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from fploc.cli import main
from fploc.datasets.build import build_sites
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError
from fploc.serve.app import make_app
from fploc.serve.messages import Measurements
from fploc.serve.phones import Conditions, Server, Walk, send_walks
from fploc.serve.recorded import recorded_intervals
from fploc.serve.replay import recorded_walks
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite
from fploc.serve.store import Store, sqlite_url
from fploc.serve.tokens import Scope, holder_of
from fploc.sites.made_up import made_up_site

_spec = importlib.util.spec_from_file_location("serving", Path(__file__).with_name("serving.py"))
assert _spec is not None and _spec.loader is not None
serving = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(serving)

PAGE = Path(__file__).parents[2] / "docs" / "phone.md"
NAME = "made-up-9"
TokenOf = Callable[..., str]


@dataclass(frozen=True)
class Running:
    """A server of the box, and a token for phones."""

    port: int
    token: str

    @property
    def server(self) -> Server:
        return Server(f"http://127.0.0.1:{self.port}", "box", self.token)


@pytest.fixture
def running(
    served: ServedSite, store: Store, settings: ServeSettings, token_of: TokenOf
) -> Iterator[Running]:
    with serving.running(make_app([served], store, settings)) as port:
        yield Running(port, token_of("upload"))


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    build_sites(None, folder, [made_up_site(9, folder / "files", laps=2, duration_s=12.0)])
    return folder


def block(language: str) -> str:
    found = re.search(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


def test_walks_arrive_in_order_and_whole(
    running: Running, recordings: list[Recording], served: ServedSite, store: Store
) -> None:
    walks = [
        Walk(f"phone-{index}", one.name, recorded_intervals(one, served.localizer.site))
        for index, one in enumerate(recordings[:2])
    ]
    sent = asyncio.run(send_walks(running.server, walks, Conditions(speed=50.0)))
    # Where an answer comes too late, a phone sends again: what was stored already counts as a duplicate.
    arrived = [one.outcomes["accepted"] + one.outcomes["duplicate"] for one in sent]
    assert arrived == [len(walk.intervals) for walk in walks]
    waiting = store.device("box", "phone-0")[2]
    used = store.track("box", "phone-0", 0.0, 1e9, 1000)
    assert len({row.t_ms for row in waiting} | {fix.t_ms for fix in used}) == len(walks[0].intervals)


def test_phones_lose_and_delay_what_they_are_told_to(
    running: Running, recordings: list[Recording], served: ServedSite
) -> None:
    walk = Walk("a", "lap", recorded_intervals(recordings[0], served.localizer.site))
    conditions = Conditions(speed=20.0, drop=0.3, delay_ms=300.0, seed=1)
    (sent,) = asyncio.run(send_walks(running.server, [walk], conditions))
    assert 0 < sent.dropped < len(walk.intervals) / 2
    arrived = sum(sent.outcomes[name] for name in ("accepted", "duplicate", "late"))
    assert arrived == len(walk.intervals) - sent.dropped and sent.outcomes["accepted"] > 0


def test_what_cannot_be_sent_is_said(
    recordings: list[Recording], served: ServedSite, running: Running
) -> None:
    walk = Walk("a", "lap", recorded_intervals(recordings[0], served.localizer.site))
    for server, found in (
        (Server(running.server.url, "box", "wrong"), "401"),
        (Server(running.server.url, "nowhere", running.token), "404"),
    ):
        with pytest.raises(FplocError, match=found):
            asyncio.run(send_walks(server, [walk], Conditions(speed=100.0)))


@pytest.mark.parametrize(
    "numbers", [{"speed": 0.0}, {"speed": float("nan")}, {"drop": 1.0}, {"delay_ms": -1.0}]
)
def test_conditions_are_checked(numbers: dict[str, float]) -> None:
    with pytest.raises(FplocError, match="--"):
        Conditions(**numbers)


def test_recordings_become_walks(data_folder: Path) -> None:
    walks = recorded_walks(data_folder, NAME, "1", None, 3)
    assert [walk.device for walk in walks] == ["phone-1", "phone-2", "phone-3"]
    assert [walk.recording for walk in walks] == ["113", "213", "113"]
    assert walks[0].intervals == walks[2].intervals and walks[0].intervals[3].truth is not None
    (one,) = recorded_walks(data_folder, NAME, "all", "124", None)
    assert one.recording == "124"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["serve"], "--site"),
        (["serve", "--site", "nowhere"], "nowhere"),
        (["serve", "--site", "../x"], "--site"),
        (["serve", "--site", NAME, "--model", "magic"], "magic"),
        (["serve", "--site", NAME, "--calibration", "lots"], "lots"),
        (["serve", "--site", NAME, "--calibration", "1", "--settings", "odd"], "odd"),
        (["serve", "--site", NAME, "--calibration", "1", "--database", "mysql://x"], "--database"),
        (["serve", "--site", NAME, "--calibration", "1", "--host", "192.0.2.1"], "--host"),
        (["serve", "--site", NAME, "--calibration", "1", "--port", "99999"], "--port"),
        (["serve", "--site", NAME, "--port", "many"], "port"),
        (["replay", "--site", NAME, "--phones", "0"], "--phones"),
        (["replay", "--site", NAME, "--device", "3"], "--device"),
        (["replay", "--site", NAME, "--recordings", "999"], "--recordings"),
        (["replay", "--site", NAME, "--drop", "2"], "--drop"),
    ],
)
def test_bad_options_end_in_one_line(
    words: list[str], named: str, data_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = ["--state", str(tmp_path)] if words[0] == "serve" else []
    assert main([*words, "--data-root", str(data_folder), *state]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("fploc: ") and len(err.splitlines()) == 1 and named in err, err


def test_tokens_are_made_and_ended_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["serve", "token", "--state", str(tmp_path)]
    assert main([*words, "--name", "phone-7", "--scope", "upload"]) == 0
    token = capsys.readouterr().out.strip()
    store = Store(sqlite_url(tmp_path))
    holder = holder_of(store, token, 0.0)
    assert holder is not None and holder.may(Scope.UPLOAD) and not holder.may(Scope.READ)
    assert main([*words, "--expire", holder.id]) == 0
    assert holder_of(store, token, 1e15) is None
    for bad in (["--expire", "nobody"], ["--scope", "write"], ["--name", "a/b"], ["--days", "0"]):
        assert main([*words, *bad]) == 2
    store.close()


def test_the_example_message_and_the_example_client_work(running: Running, store: Store) -> None:
    Measurements.model_validate_json(block("json"))
    names: dict[str, Any] = {}
    exec(block("python"), names)
    phone = names["Phone"](running.server.url, "box", running.token, "example")
    receipt = phone.send([{"bssid": "00:00:00:00:00:00", "range_m": 3.0}])
    assert receipt["accepted"] == 1 and phone.kept == []
    lost = names["Phone"]("http://127.0.0.1:9", "box", running.token, "example")
    assert lost.send([]) is None and len(lost.kept) == 1
    (body,) = re.findall(r"-d '(.*?)'", block("bash"))
    Measurements.model_validate_json(body)
    assert store.is_known("box", "example") and json.loads(body)["device"] == "phone-7"
