"""Rates and sizes that nobody may exceed."""

from __future__ import annotations

from collections.abc import Callable

from starlette.requests import Request

from fploc.serve.refusals import RefusedError

MOST_BUCKETS = 10_000


class RateLimit:
    """A bucket of requests for each key, that fills again at a rate.

    Args:
        per_s: Requests that come back each second.
        burst: Size of a bucket.
        clock: Seconds, never backwards.
    """

    def __init__(self, per_s: float, burst: int, clock: Callable[[], float]) -> None:
        self._per_s, self._burst, self._clock = per_s, burst, clock
        self._buckets: dict[str, tuple[float, float]] = {}

    def take(self, key: str) -> None:
        """Take one request out of the bucket of ``key``.

        Raises:
            RefusedError: If there is none left.
        """
        now = self._clock()
        left, at = self._buckets.pop(key, (float(self._burst), now))
        left = min(float(self._burst), left + (now - at) * self._per_s)
        if len(self._buckets) >= MOST_BUCKETS:
            # The one that was not asked for the longest is full again, or nearly so.
            del self._buckets[next(iter(self._buckets))]
        self._buckets[key] = (max(0.0, left - 1.0), now)
        if left < 1.0:
            raise RefusedError(
                429, "rate_limited", f"at most {self._per_s:g} requests a second", retry_after_s=1
            )


async def limited_body(request: Request, most_bytes: int) -> bytes:
    """Return the body of a request, of which no more is read than is allowed.

    Raises:
        RefusedError: If it is larger.
    """
    too_large = RefusedError(413, "too_large", f"at most {most_bytes} bytes: send a backlog in parts")
    announced = request.headers.get("content-length", "")
    if announced.isascii() and announced.isdigit() and (len(announced) > 15 or int(announced) > most_bytes):
        raise too_large
    parts, size = [], 0
    async for part in request.stream():
        size += len(part)
        if size > most_bytes:
            raise too_large
        parts.append(part)
    return b"".join(parts)
