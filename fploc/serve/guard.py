"""What stands before everything: how much is worked on at one time, and headers on every answer."""

from __future__ import annotations

import hashlib
import math

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fploc.serve.metrics import Metrics
from fploc.serve.refusals import RefusedError
from fploc.serve.upload_turns import UploadTurns

CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = [
    (b"content-security-policy", CONTENT_POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), geolocation=(), microphone=()"),
    (b"cache-control", b"no-store"),
]


class Guard:
    """The outermost part of the application.

    Args:
        app: The rest.
        most_in_flight: Requests at one time; more are turned away at once instead of making a queue.
        uploads: Whose turn it is to send something.
        metrics: Where those are counted.
    """

    def __init__(self, app: ASGIApp, most_in_flight: int, uploads: UploadTurns, metrics: Metrics) -> None:
        self._app = app
        self._most_in_flight = most_in_flight
        self._uploads = uploads
        self._metrics = metrics
        self._in_flight = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message["headers"], *HEADERS]}
            await send(message)

        if self._in_flight >= self._most_in_flight:
            await self._refused("too many requests at once", 1.0)(scope, receive, send_with_headers)
            return
        if scope["method"] == "POST" and (wait_s := self._uploads.wait_s(sender_of(scope))) > 0.0:
            await self._refused("keep it, and send it together with what comes", wait_s)(
                scope, receive, send_with_headers
            )
            return
        self._in_flight += 1
        try:
            await self._app(scope, receive, send_with_headers)
        finally:
            self._in_flight -= 1

    def _refused(self, message: str, wait_s: float) -> ASGIApp:
        self._metrics.rejected.labels("overloaded").inc()
        return RefusedError(503, "overloaded", message, retry_after_s=math.ceil(wait_s)).response()


def sender_of(scope: Scope) -> str:
    """Return what tells phones apart before anything is checked: the token, else the address."""
    for name, value in scope["headers"]:
        if name == b"authorization":
            return hashlib.sha256(value).hexdigest()
    client = scope.get("client")
    return "" if client is None else str(client[0])
