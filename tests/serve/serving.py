"""A server of the box in this process, on a port of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from fastapi import FastAPI

from fploc.serve.server import listening_socket, server_of


@contextmanager
def running(app: FastAPI, port: int = 0) -> Iterator[int]:
    """Yield the port of a server that ends with the block."""
    with listening_socket("127.0.0.1", port) as listening:
        server = server_of(app, listening)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        until = time.monotonic() + 60.0
        while not server.started:
            assert thread.is_alive() and time.monotonic() < until, "the server did not start"
            time.sleep(0.01)
        try:
            yield listening.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join(timeout=30)
