from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy.exc import SQLAlchemyError

from fploc.errors import FplocError, UnknownNameError
from fploc.serve.rows import DeviceRow, FixRow, StateRow, WaitingRow
from fploc.serve.session import Outcome
from fploc.serve.store import FORMAT, Store, TokenRow, sqlite_url
from fploc.serve.tokens import DAY_MS, Scope, holder_of, make_token, scopes_of
from fploc.serve.writer import StoreWriter

_spec = importlib.util.spec_from_file_location("databases", Path(__file__).with_name("databases.py"))
assert _spec is not None and _spec.loader is not None
databases = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(databases)

WAITING = WaitingRow("mall", "a", 0, "", 1000.125, 5.0, '{"t_ms": 1000.125, "readings": []}')
FIX = FixRow(
    "mall", "a", 0, "", 1000.125, 5.0, 0.1 + 0.2, -3.5, 1.0, 2.0, 0.25, "fixed", 4, "nls", None, None
)
DEVICE = DeviceRow("mall", "a", 0, "", 1000.125, 5.0, "{}")
STATE = StateRow("mall", "a", 0, 1000.125, "layout", b"\x00\xff\x01")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    # Its socket's path must be short, and every user must get into the folder.
    with tempfile.TemporaryDirectory(prefix="fploc-") as folder:
        Path(folder).chmod(0o755)
        with databases.postgresql(Path(folder)) as url:
            yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    url = sqlite_url(tmp_path) if request.param == "sqlite" else request.getfixturevalue("cluster")
    store = Store(url)
    for device in ("a", "b"):
        store.forget_device("mall", device)
    yield store
    store.close()


def test_what_waits_stops_waiting_when_the_state_has_seen_it(store: Store) -> None:
    later = replace(WAITING, t_ms=1200.0)
    anew = replace(WAITING, track=1, t_ms=3.0)
    store.write([WAITING, later, anew, replace(WAITING, device="b")], [])
    assert store.device("mall", "a") == (None, None, [WAITING, later, anew])
    store.write([], [Outcome([FIX], [DEVICE], [STATE])])
    assert store.device("mall", "a") == (DEVICE, STATE, [later, anew])
    assert store.track("mall", "a", 0.0, 1e9, 10) == [FIX]
    farther = replace(DEVICE, track=1, t_ms=3.0)
    store.write([], [Outcome([], [farther], [])])
    assert store.device("mall", "a") == (farther, STATE, [later, anew])
    seen = replace(STATE, track=1, t_ms=3.0, state=b"")
    store.write([], [Outcome([], [farther], [seen])])
    assert store.device("mall", "a") == (farther, seen, [])
    assert store.device("mall", "b")[2] == [replace(WAITING, device="b")]


def test_writing_again_changes_nothing(store: Store) -> None:
    for _ in range(2):
        store.write([WAITING], [])
        store.write([], [Outcome([FIX], [DEVICE], [STATE])])
    assert store.track("mall", "a", 0.0, 1e9, 10) == [FIX]
    assert store.device("mall", "a") == (DEVICE, STATE, [])


def test_a_track_is_cut_by_time_and_by_number(store: Store) -> None:
    fixes = [replace(FIX, t_ms=float(t), x_m=None, reason="no_reading") for t in range(5)]
    store.write([], [Outcome(fixes[::-1], [DEVICE], [STATE])])
    assert store.track("mall", "a", 1.0, 3.0, 10) == fixes[1:4]
    assert store.track("mall", "a", 0.0, 9.0, 2) == fixes[:2]
    assert store.track("mall", "b", 0.0, 9.0, 2) == []


def test_silent_devices_are_not_followed_but_kept_until_they_are_old(store: Store) -> None:
    store.write([replace(WAITING, device="b")], [Outcome([FIX], [DEVICE], [STATE])])
    assert store.followed("mall", 5.0) == ["a", "b"]
    assert store.followed("mall", 5.1) == ["b"]
    store.forget_fixes(5.0)
    assert store.is_known("mall", "a")
    store.forget_fixes(5.1)
    assert store.device("mall", "a") == (None, None, []) and store.is_known("mall", "b")
    store.forget_device("mall", "b")
    assert store.followed("mall", 0.0) == []


def test_tokens_are_known_by_their_secret_until_they_expire(store: Store) -> None:
    token = make_token(store, "phone 7", scopes_of("upload, read"), days=1.0, now_ms=0.0)
    holder = holder_of(store, token, DAY_MS - 1.0)
    assert holder is not None and holder.name == "phone 7"
    assert holder.may(Scope.UPLOAD) and holder.may(Scope.READ) and not holder.may(Scope.ADMIN)
    assert holder_of(store, token, DAY_MS) is None
    wrong = token[:-1] + ("A" if token[-1] != "A" else "B")
    for other in (wrong, token.upper(), "", "fploc__", token + "x"):
        assert holder_of(store, other, 0.0) is None
    stored = next(row for row in store.tokens() if row.id == holder.id)
    assert token.split("_", 2)[2] not in str(stored) and len(stored.hash) == 64
    assert store.expire_token(holder.id, 5.0) and holder_of(store, token, 6.0) is None
    assert not store.expire_token("nobody", 5.0)


def test_admin_may_everything(store: Store) -> None:
    token = make_token(store, "admin", frozenset({Scope.ADMIN}), days=1.0, now_ms=0.0)
    holder = holder_of(store, token, 0.0)
    assert holder is not None and all(holder.may(scope) for scope in Scope)


@pytest.mark.parametrize(
    ("name", "days"), [("", 1.0), ("a/b", 1.0), ("x" * 65, 1.0), ("a", 0.0), ("a", float("nan"))]
)
def test_names_and_days_of_tokens_are_checked(name: str, days: float, tmp_path: Path) -> None:
    with pytest.raises(FplocError):
        make_token(Store(sqlite_url(tmp_path)), name, frozenset({Scope.READ}), days, 0.0)
    with pytest.raises(UnknownNameError, match="upload, read, admin"):
        scopes_of("upload,write")


def test_the_writer_commits_in_order_and_tells_when(tmp_path: Path) -> None:
    store = Store(sqlite_url(tmp_path))
    writer = StoreWriter(store)
    waits = [writer.write([replace(WAITING, t_ms=float(t))], []) for t in range(50)]
    last = writer.write([], [Outcome([FIX], [DEVICE], [replace(STATE, t_ms=48.0)])])
    last.result(timeout=30)
    assert all(wait.done() for wait in waits)
    assert [row.t_ms for row in store.device("mall", "a")[2]] == [49.0]
    writer.close()


def test_the_writer_says_what_was_not_stored_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(sqlite_url(tmp_path))
    writer, write = StoreWriter(store), store.write

    def full(*_: object) -> None:
        raise SQLAlchemyError("disk full")

    monkeypatch.setattr(store, "write", full)
    failed: Future[None] = writer.write([WAITING], [])
    with pytest.raises(SQLAlchemyError, match="disk full"):
        failed.result(timeout=30)
    assert writer.is_failing
    monkeypatch.setattr(store, "write", write)
    writer.write([WAITING], []).result(timeout=30)
    assert not writer.is_failing and store.is_known("mall", "a")
    writer.close()


@pytest.mark.parametrize(
    "url", ["", "mysql://x/y", "nonsense", "sqlite:////no/such/folder/x.db", "postgresql://127.0.0.1:1/x"]
)
def test_a_database_that_cannot_be_used_is_named(url: str) -> None:
    with pytest.raises(FplocError, match="--database"):
        Store(url)


def test_tables_of_another_format_are_refused(tmp_path: Path) -> None:
    store = Store(sqlite_url(tmp_path))
    with store._engine.begin() as connection:
        connection.execute(FORMAT.update().values(version=99))
    with pytest.raises(FplocError, match="format 99"):
        Store(sqlite_url(tmp_path))


def test_a_token_without_an_end_stays_valid(tmp_path: Path) -> None:
    store = Store(sqlite_url(tmp_path))
    token = make_token(store, "a", frozenset({Scope.READ}), days=1.0, now_ms=0.0)
    (row,) = store.tokens()
    store.add_token(replace(TokenRow(**vars(row)), id="0" * 12, expires_ms=None))
    assert holder_of(store, f"fploc_{'0' * 12}_{token.split('_', 2)[2]}", 1e15) is not None
