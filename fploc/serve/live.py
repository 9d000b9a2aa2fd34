"""Live connections of a site: each gets the newest tick; one that reads slowly misses ticks, not the newest."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager


class Listener:
    """One live connection."""

    def __init__(self) -> None:
        self._news = asyncio.Event()
        self._newest = ""

    def tell(self, text: str) -> None:
        """Replace what waits to be sent."""
        self._newest = text
        self._news.set()

    async def texts(self) -> AsyncIterator[str]:
        """Yield what is to be sent, forever."""
        while True:
            await self._news.wait()
            self._news.clear()
            yield self._newest


class Live:
    """All live connections of a site."""

    def __init__(self) -> None:
        self._listeners: set[Listener] = set()

    def __len__(self) -> int:
        return len(self._listeners)

    @contextmanager
    def listening(self) -> Iterator[Listener]:
        """Yield a listener that is told every tick within the block."""
        listener = Listener()
        self._listeners.add(listener)
        try:
            yield listener
        finally:
            self._listeners.discard(listener)

    def publish(self, text: str) -> None:
        """Tell all listeners."""
        for listener in self._listeners:
            listener.tell(text)
