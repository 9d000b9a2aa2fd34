"""Downloads from a server in a thread: every way in which a network fails, and what is left on disk."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import FrameType
from urllib.parse import unquote

import httpx
import pytest

from fploc.datasets import download as module
from fploc.datasets.download import Patience, UnreachableError, download, fetch, resolve_source
from fploc.datasets.source_files import REVISIONS, SourceFile, blob_sha1
from fploc.errors import DownloadError, FplocError, HashMismatchError

REVISION = "2b19c6c"
QUICK = Patience(connect_s=10.0, read_s=10.0, attempts=3, backoff_s=0.01)
"""Quick to try again; a busy machine may still take its time to answer."""
CONTENTS = bytes(range(256)) * 2000


class Handler(BaseHTTPRequestHandler):
    """Serves ``server.shelf``; a fault named there is used up by the first GET that meets it."""

    server: Server

    def do_HEAD(self) -> None:
        self.server.shelf.probes += 1
        statuses = self.server.shelf.probe_statuses
        self.send_response(statuses.pop(0) if statuses else 200)
        self.end_headers()

    def do_GET(self) -> None:
        name = unquote(self.path).removeprefix(f"/{REVISIONS[REVISION]}/")
        shelf = self.server.shelf
        shelf.requests.append((name, self.headers.get("Range")))
        fault = shelf.faults.get(name, [])
        if fault:
            fault.pop(0)(self, shelf.contents[name])
        elif name in shelf.contents:
            self.send(shelf.contents[name])
        else:
            self.send_error(404)

    def send(self, contents: bytes, *, at_most: int | None = None) -> None:
        start = int((self.headers.get("Range") or "bytes=0-").removeprefix("bytes=").rstrip("-"))
        if start and start >= len(contents):
            self.send_error(416)
            return
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(contents) - start))
        self.end_headers()
        self.wfile.write(contents[start:at_most])

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@dataclass
class Shelf:
    url: str
    contents: dict[str, bytes] = field(default_factory=dict)
    faults: dict[str, list[Callable[[Handler, bytes], None]]] = field(default_factory=dict)
    requests: list[tuple[str, str | None]] = field(default_factory=list)
    probe_statuses: list[int] = field(default_factory=list)
    probes: int = 0

    def file(self, path: str, contents: bytes = CONTENTS) -> SourceFile:
        self.contents[path] = contents
        return SourceFile(REVISION, path, blob_sha1(contents), len(contents))


class Server(ThreadingHTTPServer):
    shelf: Shelf


@pytest.fixture
def shelf() -> Iterator[Shelf]:
    with Server(("127.0.0.1", 0), Handler) as server:
        server.shelf = Shelf(f"http://127.0.0.1:{server.server_port}")
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.shelf
        server.shutdown()
        thread.join()


def truncated(handler: Handler, contents: bytes) -> None:
    handler.send(contents, at_most=len(contents) // 2)


def unavailable(handler: Handler, contents: bytes) -> None:
    handler.send_error(503)


def forbidden(handler: Handler, contents: bytes) -> None:
    handler.send_error(403)


def nothing(handler: Handler, contents: bytes) -> None:
    handler.close_connection = True


def wrong_bytes(handler: Handler, contents: bytes) -> None:
    handler.send(b"\0" * len(contents))


def files_below(folder: Path) -> list[Path]:
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def test_paths_with_spaces_and_signs_arrive_verified(shelf: Shelf, tmp_path: Path) -> None:
    files = [shelf.file("raw data/A #1/~$x (1).csv"), shelf.file("LICENSE", b"MIT"), shelf.file("empty", b"")]
    fetch(files, tmp_path, base_url=shelf.url, patience=QUICK)
    assert [file.below(tmp_path).read_bytes() for file in files] == [CONTENTS, b"MIT", b""]
    assert len(files_below(tmp_path)) == 3


def test_an_intact_file_is_not_asked_for_again(shelf: Shelf, tmp_path: Path) -> None:
    files = [shelf.file("a.csv"), shelf.file("b.csv")]
    fetch(files, tmp_path, base_url=shelf.url, patience=QUICK)
    files[0].below(tmp_path).write_bytes(b"spoilt later")
    shelf.requests.clear()
    fetch(files, tmp_path, base_url=shelf.url, patience=QUICK)
    assert shelf.requests == [("a.csv", None)]
    assert files[0].below(tmp_path).read_bytes() == CONTENTS


def test_a_truncated_answer_is_continued_where_it_ended(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    shelf.faults["a.csv"] = [truncated]
    fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    first, second = shelf.requests
    assert first == ("a.csv", None)
    assert second[1] is not None and 0 < int(second[1][6:-1]) <= len(CONTENTS) // 2
    assert file.below(tmp_path).read_bytes() == CONTENTS


def test_a_busy_server_is_asked_again(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    shelf.faults["a.csv"] = [unavailable, unavailable]
    fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert len(shelf.requests) == 3
    assert file.below(tmp_path).read_bytes() == CONTENTS


@pytest.mark.parametrize(
    ("statuses", "probes"), [([500, 502, 503], 3), ([403], 1), ([407], 1)], ids=lambda value: str(value)
)
def test_a_server_that_refuses_from_the_first_word_is_unreachable(
    statuses: list[int], probes: int, shelf: Shelf, tmp_path: Path
) -> None:
    last = statuses[-1]
    shelf.probe_statuses += statuses
    with pytest.raises(UnreachableError, match=rf"a\.csv: found HTTP {last}, .*; check the network"):
        fetch([shelf.file("a.csv")], tmp_path, base_url=shelf.url, patience=QUICK)
    assert (shelf.probes, shelf.requests) == (probes, [])
    assert files_below(tmp_path) == []


def test_a_proxy_that_refuses_is_unreachable(shelf: Shelf, tmp_path: Path) -> None:
    with httpx.Client(proxy=shelf.url) as client, pytest.raises(UnreachableError, match="check the network"):
        fetch([shelf.file("a.csv")], tmp_path, base_url="https://fploc.invalid", client=client)


def test_a_server_that_is_busy_at_first_is_asked_again(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    shelf.probe_statuses += [503, 503]
    fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert shelf.probes == 3 and file.below(tmp_path).read_bytes() == CONTENTS


@pytest.mark.parametrize(
    ("fault", "told", "asked"),
    [
        (unavailable, "HTTP 503", QUICK.attempts),
        (forbidden, "HTTP 403", 1),
        (nothing, "Server disconnected", QUICK.attempts),
    ],
    ids=["503", "403", "hangs up"],
)
def test_a_file_that_fails_after_an_answer_is_named_and_the_server_counts_as_reached(
    fault: Callable[[Handler, bytes], None], told: str, asked: int, shelf: Shelf, tmp_path: Path
) -> None:
    file = shelf.file("a.csv")
    shelf.faults["a.csv"] = [fault] * 9
    with pytest.raises(DownloadError, match=rf"2b19c6c/a\.csv: found {told}.*; what has arrived") as caught:
        fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert not isinstance(caught.value, UnreachableError)
    assert len(shelf.requests) == asked
    assert files_below(tmp_path) == []


def test_what_arrived_of_a_file_that_fails_is_kept(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    shelf.faults["a.csv"] = [truncated, unavailable, unavailable]
    with pytest.raises(DownloadError, match=r"a\.csv: found HTTP 503") as caught:
        fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert not isinstance(caught.value, UnreachableError)
    part = file.below(tmp_path).with_name("a.csv.part")
    assert CONTENTS.startswith(part.read_bytes()) and part.stat().st_size > 0
    fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert file.below(tmp_path).read_bytes() == CONTENTS


def test_wrong_bytes_name_both_hashes_and_are_deleted(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    shelf.faults["a.csv"] = [wrong_bytes]
    with pytest.raises(HashMismatchError) as caught:
        fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert file.blob_sha1 in str(caught.value)
    assert blob_sha1(b"\0" * len(CONTENTS)) in str(caught.value)
    assert files_below(tmp_path) == []


@pytest.mark.parametrize("older", [CONTENTS[:1000], CONTENTS, b"not the file" * 60_000, b"not the file"])
def test_a_partial_file_of_an_older_call_is_continued_or_replaced(
    shelf: Shelf, tmp_path: Path, older: bytes
) -> None:
    file = shelf.file("a.csv")
    part = file.below(tmp_path).with_name("a.csv.part")
    part.parent.mkdir(parents=True)
    part.write_bytes(older)
    fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert shelf.requests[0] == ("a.csv", f"bytes={len(older)}-")
    assert file.below(tmp_path).read_bytes() == CONTENTS
    assert not part.exists()


def test_a_missing_file_names_its_address(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("there.csv")
    gone = SourceFile(REVISION, "gone.csv", file.blob_sha1, file.size)
    with pytest.raises(DownloadError, match=r"gone\.csv: found HTTP 404, expected a file") as caught:
        fetch([gone, file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert not isinstance(caught.value, UnreachableError)


def test_no_server_is_told_within_seconds(tmp_path: Path) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{closed.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(UnreachableError, match="--from DIR"):
            fetch([SourceFile(REVISION, "a.csv", "0" * 40, 1)], tmp_path, base_url=url)
    assert time.monotonic() - started < 5
    assert files_below(tmp_path) == []


def test_an_unknown_host_is_told_within_seconds(tmp_path: Path) -> None:
    started = time.monotonic()
    with pytest.raises(UnreachableError):
        fetch([SourceFile(REVISION, "a.csv", "0" * 40, 1)], tmp_path, base_url="http://fploc.invalid")
    assert time.monotonic() - started < 8


@pytest.fixture
def interrupted() -> Iterator[threading.Event]:
    """Set once Ctrl-C has reached the main thread, however busy the machine is."""
    reached = threading.Event()

    def interrupt(signum: int, frame: FrameType | None) -> None:
        reached.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, interrupt)
    yield reached
    signal.signal(signal.SIGINT, before)


def test_an_interrupted_download_leaves_partial_files_that_resume(
    shelf: Shelf, tmp_path: Path, interrupted: threading.Event
) -> None:
    first, second = shelf.file("a.csv", CONTENTS * 20), shelf.file("b.csv", CONTENTS * 20)
    whole = len(CONTENTS) * 20
    patient = Patience(connect_s=0.5, read_s=30.0, attempts=3, backoff_s=0.01)

    def interrupting(handler: Handler, contents: bytes) -> None:
        handler.send_response(200)
        handler.send_header("Content-Length", str(whole))
        handler.end_headers()
        handler.wfile.write(contents[: whole // 2])
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        interrupted.wait(20.0)
        time.sleep(0.5)
        handler.wfile.write(contents[whole // 2 :])

    shelf.faults["a.csv"] = [interrupting]
    with pytest.raises(KeyboardInterrupt):
        fetch([first, second], tmp_path, base_url=shelf.url, patience=patient)
    assert not first.below(tmp_path).exists()
    part = first.below(tmp_path).with_name("a.csv.part")
    size = part.stat().st_size
    assert 0 < size < whole

    shelf.requests.clear()
    fetch([first, second], tmp_path, base_url=shelf.url, patience=QUICK)
    assert ("a.csv", f"bytes={size}-") in shelf.requests
    assert first.below(tmp_path).read_bytes() == CONTENTS * 20
    assert [path.name for path in files_below(tmp_path)] == ["a.csv", "b.csv"]


def test_a_full_disk_ends_in_one_error_and_leaves_nothing(shelf: Shelf, tmp_path: Path) -> None:
    file = shelf.file("a.csv")
    part = file.below(tmp_path).with_name("a.csv.part")
    part.parent.mkdir(parents=True)
    part.symlink_to("/dev/full")
    with pytest.raises(DownloadError, match=r"a\.csv: found No space left .*free some space.*--data-root"):
        fetch([file], tmp_path, base_url=shelf.url, patience=QUICK)
    assert files_below(tmp_path) == [] and not part.is_symlink()


def test_a_cache_that_is_a_file_ends_in_one_error(shelf: Shelf, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(DownloadError, match=r"cache is no folder"):
        fetch([shelf.file("a.csv")], tmp_path / "cache", base_url=shelf.url, patience=QUICK)


def test_a_site_is_fetched_with_all_its_files(
    shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [shelf.file("plan.png"), shelf.file("lap.csv", b"1,2")]
    monkeypatch.setattr(module, "site_files", lambda sites: files if list(sites) == ["office"] else [])
    folder = download(["office"], tmp_path, base_url=shelf.url, patience=QUICK)
    assert sorted(path.name for path in files_below(folder)) == ["lap.csv", "plan.png"]


def usable_folder(folder: Path) -> Path:
    lap = folder / REVISION / "raw_data" / "Laboratory" / "1" / "113.csv"
    lap.parent.mkdir(parents=True)
    lap.write_text("a lap")
    return folder


def test_the_option_comes_before_the_variable_and_neither_uses_the_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "fetch", lambda *_, **__: pytest.fail("the network was used"))
    option, variable = usable_folder(tmp_path / "option"), usable_folder(tmp_path / "variable")
    monkeypatch.setenv("FPLOC_SOURCE", str(variable))
    assert resolve_source(tmp_path, option, ["office"]) == option
    assert resolve_source(tmp_path, None, ["office"]) == variable


@pytest.mark.parametrize("kind", ["absent", "a file", "another folder", "no recordings"])
def test_an_unusable_folder_says_who_named_it_and_what_was_expected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    folder = tmp_path / "given"
    if kind == "a file":
        folder.write_text("x")
    if kind == "another folder":
        (folder / "raw_data").mkdir(parents=True)
    if kind == "no recordings":
        (folder / REVISION / "raw_data").mkdir(parents=True)
    monkeypatch.setenv("FPLOC_SOURCE", str(folder))
    for given, name in ((None, "FPLOC_SOURCE"), (folder, "--from")):
        with pytest.raises(FplocError, match="2b19c6c") as caught:
            resolve_source(tmp_path, given, ["office"])
        assert name in str(caught.value) and str(folder) in str(caught.value)


def test_without_a_named_folder_the_cache_is_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FPLOC_SOURCE", raising=False)
    monkeypatch.setattr(module, "download", lambda sites, cache: cache)
    assert resolve_source(tmp_path, None, ["office"]) == tmp_path / "source"
