"""What survives the server: tokens, reading sets that wait, fixes, and the state of every device.

SQLite in a file (write-ahead log) unless a URL names another database, for example PostgreSQL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    Column,
    Engine,
    Float,
    Integer,
    LargeBinary,
    MetaData,
    Row,
    String,
    Table,
    Text,
    bindparam,
    create_engine,
    delete,
    event,
    exists,
    insert,
    inspect,
    or_,
    select,
    update,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from fploc.errors import FplocError
from fploc.serve.rows import DeviceRow, FixRow, StateRow, WaitingRow
from fploc.serve.session import Outcome

FORMAT_VERSION = 2

_metadata = MetaData()
_DOUBLE = Float(53)

FORMAT = Table("fploc_format", _metadata, Column("version", Integer, primary_key=True))
TOKENS = Table(
    "fploc_tokens",
    _metadata,
    Column("id", String(16), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("hash", String(64), nullable=False),
    Column("scopes", String(64), nullable=False),
    Column("created_ms", _DOUBLE, nullable=False),
    Column("expires_ms", _DOUBLE),
)
WAITING = Table(
    "fploc_waiting",
    _metadata,
    Column("site", String(64), primary_key=True),
    Column("device", String(64), primary_key=True),
    Column("track", Integer, primary_key=True),
    Column("t_ms", _DOUBLE, primary_key=True),
    Column("recording", String(64), nullable=False),
    Column("received_ms", _DOUBLE, nullable=False),
    Column("body", Text, nullable=False),
)
FIXES = Table(
    "fploc_fixes",
    _metadata,
    Column("site", String(64), primary_key=True),
    Column("device", String(64), primary_key=True),
    Column("track", Integer, primary_key=True),
    Column("t_ms", _DOUBLE, primary_key=True),
    Column("recording", String(64), nullable=False),
    Column("received_ms", _DOUBLE, nullable=False, index=True),
    Column("x_m", _DOUBLE),
    Column("y_m", _DOUBLE),
    Column("variance_x_m2", _DOUBLE),
    Column("variance_y_m2", _DOUBLE),
    Column("covariance_xy_m2", _DOUBLE),
    Column("reason", String(32), nullable=False),
    Column("access_points", Integer, nullable=False),
    Column("method", String(64), nullable=False),
    Column("truth_x_m", _DOUBLE),
    Column("truth_y_m", _DOUBLE),
)
DEVICES = Table(
    "fploc_devices",
    _metadata,
    Column("site", String(64), primary_key=True),
    Column("device", String(64), primary_key=True),
    Column("track", Integer, nullable=False),
    Column("recording", String(64), nullable=False),
    Column("t_ms", _DOUBLE, nullable=False),
    Column("received_ms", _DOUBLE, nullable=False),
    Column("fix", Text, nullable=False),
)
STATES = Table(
    "fploc_states",
    _metadata,
    Column("site", String(64), primary_key=True),
    Column("device", String(64), primary_key=True),
    Column("track", Integer, nullable=False),
    Column("t_ms", _DOUBLE, nullable=False),
    Column("layout", String(16), nullable=False),
    Column("state", LargeBinary, nullable=False),
)
_USED = delete(WAITING).where(
    WAITING.c.site == bindparam("used_site"),
    WAITING.c.device == bindparam("used_device"),
    or_(
        WAITING.c.track < bindparam("used_track"),
        (WAITING.c.track == bindparam("used_track")) & (WAITING.c.t_ms <= bindparam("used_t_ms")),
    ),
)


@dataclass(frozen=True)
class TokenRow:
    """A token as it is stored: ``hash`` is the SHA-256 of its secret, hexadecimal; ``scopes`` by commas."""

    id: str
    name: str
    hash: str
    scopes: str
    created_ms: float
    expires_ms: float | None


def sqlite_url(folder: Path) -> str:
    """Return the URL of the database in a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    return f"sqlite:///{(folder / 'serve.db').resolve()}"


class Store:
    """The database.

    Args:
        url: Of SQLAlchemy, for SQLite or PostgreSQL.

    Raises:
        FplocError: If it cannot be used.
    """

    def __init__(self, url: str) -> None:
        self._engine = _engine(url)
        dialects: dict[str, Any] = {"sqlite": sqlite.insert, "postgresql": postgresql.insert}
        insert_of = dialects[self._engine.dialect.name]
        self._add_waiting = insert_of(WAITING).on_conflict_do_nothing()
        self._add_fixes = insert_of(FIXES).on_conflict_do_nothing()
        self._set_devices = _replacing(insert_of(DEVICES))
        self._set_states = _replacing(insert_of(STATES))
        try:
            _metadata.create_all(self._engine)
            self._check_format()
        except SQLAlchemyError as error:
            raise _unusable(url, error) from error

    def _check_format(self) -> None:
        with self._engine.begin() as connection:
            found = connection.execute(select(FORMAT.c.version)).scalar()
            if found is None:
                connection.execute(insert(FORMAT).values(version=FORMAT_VERSION))
            elif found != FORMAT_VERSION:
                raise FplocError(
                    "--database",
                    value=f"tables of format {found}",
                    expected=f"format {FORMAT_VERSION}",
                    way_out="name another database",
                )

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    def check(self) -> None:
        """Do nothing where the database answers.

        Raises:
            SQLAlchemyError: If it does not.
        """
        with self._engine.connect() as connection:
            connection.execute(select(FORMAT.c.version)).scalar()

    def write(self, received: Sequence[WaitingRow], outcomes: Sequence[Outcome]) -> None:
        """Store what came in, then what was made of it, in one transaction.

        Reading sets that a device's state has seen are dropped in the same transaction as the state is stored.
        """
        latest = {(row.site, row.device): row for one in outcomes for row in one.devices}
        states = {(row.site, row.device): row for one in outcomes for row in one.states}
        fixes = [vars(fix) for one in outcomes for fix in one.fixes]
        with self._engine.begin() as connection:
            if received:
                connection.execute(self._add_waiting, [vars(row) for row in received])
            if fixes:
                connection.execute(self._add_fixes, fixes)
            if latest:
                connection.execute(self._set_devices, [vars(row) for row in latest.values()])
            if states:
                connection.execute(self._set_states, [vars(row) for row in states.values()])
                connection.execute(_USED, [_used(row) for row in states.values()])

    def followed(self, site: str, since_ms: float) -> list[str]:
        """Return the devices of a site that sent something since then, or that have something waiting."""
        with self._engine.connect() as connection:
            recent = connection.execute(
                select(DEVICES.c.device).where(DEVICES.c.site == site, DEVICES.c.received_ms >= since_ms)
            ).scalars()
            waiting = connection.execute(
                select(WAITING.c.device).where(WAITING.c.site == site).distinct()
            ).scalars()
            return sorted({*recent, *waiting})

    def device(self, site: str, device: str) -> tuple[DeviceRow | None, StateRow | None, list[WaitingRow]]:
        """Return how far a device has come and a state of it, None where it has none, and what came after that."""
        with self._engine.connect() as connection:
            known = connection.execute(
                select(DEVICES).where(DEVICES.c.site == site, DEVICES.c.device == device)
            ).one_or_none()
            state = connection.execute(
                select(STATES).where(STATES.c.site == site, STATES.c.device == device)
            ).one_or_none()
            waiting = connection.execute(
                select(WAITING)
                .where(WAITING.c.site == site, WAITING.c.device == device)
                .order_by(WAITING.c.track, WAITING.c.t_ms)
            ).all()
        return (
            None if known is None else DeviceRow(**_values(known)),
            None if state is None else StateRow(**_values(state)),
            [WaitingRow(**_values(one)) for one in waiting],
        )

    def track(self, site: str, device: str, from_ms: float, to_ms: float, most: int) -> list[FixRow]:
        """Return fixes of a device, device time from ``from_ms`` up to ``to_ms``, oldest first."""
        query = (
            select(FIXES)
            .where(
                FIXES.c.site == site,
                FIXES.c.device == device,
                FIXES.c.t_ms >= from_ms,
                FIXES.c.t_ms <= to_ms,
            )
            .order_by(FIXES.c.track, FIXES.c.t_ms)
            .limit(most)
        )
        with self._engine.connect() as connection:
            return [FixRow(**_values(row)) for row in connection.execute(query)]

    def is_known(self, site: str, device: str) -> bool:
        """Return whether anything of a device is stored."""
        row, _, waiting = self.device(site, device)
        return row is not None or bool(waiting)

    def forget_device(self, site: str, device: str) -> None:
        """Delete all that is stored of a device."""
        with self._engine.begin() as connection:
            for table in (WAITING, FIXES, DEVICES, STATES):
                connection.execute(delete(table).where(table.c.site == site, table.c.device == device))

    def forget_fixes(self, before_ms: float) -> None:
        """Delete fixes whose readings came in before then, and devices silent since."""
        with self._engine.begin() as connection:
            connection.execute(delete(FIXES).where(FIXES.c.received_ms < before_ms))
            is_old = DEVICES.c.received_ms < before_ms
            its_own = (DEVICES.c.site == STATES.c.site) & (DEVICES.c.device == STATES.c.device)
            connection.execute(delete(STATES).where(exists().where(its_own & is_old)))
            connection.execute(delete(DEVICES).where(is_old))

    def add_token(self, token: TokenRow) -> None:
        """Store a token."""
        with self._engine.begin() as connection:
            connection.execute(insert(TOKENS).values(**vars(token)))

    def token(self, token_id: str) -> TokenRow | None:
        """Return a token, None where there is none."""
        with self._engine.connect() as connection:
            row = connection.execute(select(TOKENS).where(TOKENS.c.id == token_id)).one_or_none()
        return None if row is None else TokenRow(**_values(row))

    def tokens(self) -> list[TokenRow]:
        """Return all tokens, oldest first."""
        with self._engine.connect() as connection:
            return [
                TokenRow(**_values(row))
                for row in connection.execute(select(TOKENS).order_by(TOKENS.c.created_ms))
            ]

    def expire_token(self, token_id: str, now_ms: float) -> bool:
        """Let a token expire now, and return whether there was one."""
        with self._engine.begin() as connection:
            done = connection.execute(update(TOKENS).where(TOKENS.c.id == token_id).values(expires_ms=now_ms))
            return done.rowcount > 0


def _replacing(adding: Any) -> Any:
    """Return an insertion of a device's row that takes the place of the one before."""
    table = adding.table
    values = {column.name: adding.excluded[column.name] for column in table.c if not column.primary_key}
    return adding.on_conflict_do_update(index_elements=[table.c.site, table.c.device], set_=values)


def _engine(url: str) -> Engine:
    try:
        parsed = make_url(url)
        if parsed.drivername == "postgresql":
            parsed = parsed.set(drivername="postgresql+psycopg")
        if parsed.get_backend_name() not in ("sqlite", "postgresql"):
            raise ArgumentError(f"a database of the kind {parsed.get_backend_name()}")
        engine = create_engine(parsed, pool_pre_ping=True)
        if engine.dialect.name == "sqlite":
            event.listen(engine, "connect", _prepare_sqlite)
        inspect(engine)
    except (ArgumentError, NoSuchModuleError, SQLAlchemyError, ImportError) as error:
        raise _unusable(url, error) from error
    return engine


def _prepare_sqlite(connection: Any, record: object) -> None:
    """Write ahead; FULL: what is committed outlives a loss of power."""
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "busy_timeout=10000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _unusable(url: str, error: Exception) -> FplocError:
    shown = url.partition("://")[0]
    reason = " ".join(str(getattr(error, "orig", None) or error).split())
    return FplocError(
        f"--database ({shown})",
        value=reason,
        expected="a database that can be written to",
        way_out="write sqlite:////folder/file.db or postgresql://user@host/name",
    )


def _values(row: Row[Any]) -> dict[str, Any]:
    return dict(row._mapping)


def _used(row: StateRow) -> dict[str, object]:
    return {
        "used_site": row.site,
        "used_device": row.device,
        "used_track": row.track,
        "used_t_ms": row.t_ms,
    }
