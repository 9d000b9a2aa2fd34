"""Bearer tokens: ``fploc_<id>_<secret>``. The secret is shown once and stored as its hash."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass
from enum import StrEnum

from fploc.errors import FplocError, UnknownNameError
from fploc.serve.store import Store, TokenRow

_FORM = re.compile(r"fploc_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,63}")
DAY_MS = 86_400_000.0


class Scope(StrEnum):
    """What a token allows; ``admin`` allows everything."""

    UPLOAD = "upload"
    READ = "read"
    ADMIN = "admin"


@dataclass(frozen=True)
class Holder:
    """Whoever has shown a valid token."""

    id: str
    name: str
    scopes: frozenset[Scope]

    def may(self, scope: Scope) -> bool:
        """Return whether the token allows it."""
        return scope in self.scopes or Scope.ADMIN in self.scopes


def scopes_of(text: str) -> frozenset[Scope]:
    """Return the scopes that a list with commas names.

    Raises:
        UnknownNameError: If one is unknown.
    """
    known = [str(scope) for scope in Scope]
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise UnknownNameError("--scope", name, known=known, way_out="name these, commas between")
    return frozenset(Scope(name) for name in names)


def make_token(store: Store, name: str, scopes: frozenset[Scope], days: float, now_ms: float) -> str:
    """Store a new token and return it: nobody can read it later.

    Args:
        store: Where to.
        name: What it is for.
        scopes: What it allows.
        days: How long it is valid.
        now_ms: Server's clock.

    Raises:
        FplocError: If the name or the days cannot be used.
    """
    if _NAME.fullmatch(name) is None:
        raise FplocError(
            "--name",
            value=repr(name),
            expected="1 to 64 letters, digits, spaces, dots, dashes or underscores",
            way_out="name what the token is for, for example phone-7",
        )
    if not 0 < days <= 3650:
        raise FplocError(
            "--days", value=days, expected="a number above 0, up to 3650", way_out="for example `--days 90`"
        )
    token_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    store.add_token(
        TokenRow(
            id=token_id,
            name=name,
            hash=_hash(secret),
            scopes=",".join(sorted(scopes)),
            created_ms=now_ms,
            expires_ms=now_ms + days * DAY_MS,
        )
    )
    return f"fploc_{token_id}_{secret}"


def holder_of(store: Store, token: str, now_ms: float) -> Holder | None:
    """Return who holds a token; None where it is wrong or has expired."""
    form = _FORM.fullmatch(token)
    row = None if form is None else store.token(form[1])
    if form is None or row is None or not hmac.compare_digest(row.hash, _hash(form[2])):
        return None
    if row.expires_ms is not None and row.expires_ms <= now_ms:
        return None
    return Holder(row.id, row.name, frozenset(Scope(name) for name in row.scopes.split(",")))


def _hash(secret: str) -> str:
    """Return the SHA-256: a secret of 256 random bits needs no slow hash."""
    return hashlib.sha256(secret.encode()).hexdigest()
