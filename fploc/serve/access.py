"""Who may do what: bearer tokens, checked against the store and remembered for a moment."""

from __future__ import annotations

import asyncio
import time

from starlette.requests import HTTPConnection

from fploc.serve.limits import RateLimit
from fploc.serve.refusals import RefusedError
from fploc.serve.settings import ServeSettings
from fploc.serve.store import Store
from fploc.serve.tokens import Holder, Scope, holder_of

REMEMBERED_S = 5.0
"""A token that is taken away still works for so long."""
MOST_REMEMBERED = 10_000
BEARER_PROTOCOL = "bearer."
"""Browsers send a live connection's token as a sub-protocol: they can set no header."""


class Access:
    """Checks tokens and their rates.

    Args:
        store: Of the tokens.
        settings: Rates, and whether anyone may read.
    """

    def __init__(self, store: Store, settings: ServeSettings) -> None:
        self._store = store
        self._settings = settings
        self._rates = RateLimit(settings.requests_per_s, settings.request_burst, time.monotonic)
        self._remembered: dict[str, tuple[Holder, float]] = {}

    async def require(self, connection: HTTPConnection, scope: Scope) -> None:
        """Do nothing where the connection may.

        Raises:
            RefusedError: If it shows no valid token, one that does not allow it, or shows it too often.
        """
        token = token_of(connection)
        if token is None:
            self._rates.take(f"address {address_of(connection)}")
            if scope is Scope.READ and self._settings.is_read_anonymous:
                return
            raise RefusedError(401, "no_token", "send a token: Authorization: Bearer fploc_…")
        holder = await self._holder(token)
        if holder is None:
            self._rates.take(f"address {address_of(connection)}")
            raise RefusedError(401, "bad_token", "the token is unknown or has expired")
        self._rates.take(f"token {holder.id}")
        if not holder.may(scope):
            raise RefusedError(403, "wrong_scope", f"the token does not allow {scope}")

    async def _holder(self, token: str) -> Holder | None:
        now = time.monotonic()
        known = self._remembered.get(token)
        if known is not None and now - known[1] < REMEMBERED_S:
            return known[0]
        holder = await asyncio.to_thread(holder_of, self._store, token, time.time() * 1000.0)
        self._remembered.pop(token, None)
        if holder is not None:
            if len(self._remembered) >= MOST_REMEMBERED:
                del self._remembered[next(iter(self._remembered))]
            self._remembered[token] = (holder, now)
        return holder


def token_of(connection: HTTPConnection) -> str | None:
    """Return the token that a request or a live connection shows."""
    kind, _, token = connection.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return token.strip()
    protocols = connection.scope.get("subprotocols", [])
    return next(
        (one.removeprefix(BEARER_PROTOCOL) for one in protocols if one.startswith(BEARER_PROTOCOL)), None
    )


def address_of(connection: HTTPConnection) -> str:
    """Return where a connection comes from."""
    return "unknown" if connection.client is None else connection.client.host
