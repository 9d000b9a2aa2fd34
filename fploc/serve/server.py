"""Starting the server."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence

import uvicorn
from fastapi import FastAPI

from fploc.errors import FplocError
from fploc.serve.site_service import ServedSite

KEEP_ALIVE_S = 75
LARGEST_LIVE_MESSAGE_BYTES = 4096
"""Nobody has anything to say on a live connection."""


def server_of(app: FastAPI, listening: socket.socket) -> uvicorn.Server:
    """Return a server of ``app``; hand it the socket to start it."""
    config = uvicorn.Config(
        app,
        fd=listening.fileno(),
        http="httptools",
        ws="websockets-sansio",
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=5,
        ws_max_size=LARGEST_LIVE_MESSAGE_BYTES,
    )
    return uvicorn.Server(config)


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens there.

    Raises:
        FplocError: If it cannot.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=512)
    except (OSError, OverflowError) as error:
        raise FplocError(
            f"--host {host} --port {port}",
            value=str(error),
            expected="an address of this machine with a free port",
            way_out="name another, for example `--port 8001`",
        ) from error


def announcement(sites: Sequence[ServedSite], listening: socket.socket) -> str:
    """Return what is served where, and who can reach it."""
    host, port = listening.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    names = ", ".join(
        f"{one.localizer.site.name} with {one.localizer.method.name} for people at {one.speed_prior_mps:g} m/s"
        for one in sites
    )
    reach = (
        "only this machine can reach it; --host 0.0.0.0 opens it to the network"
        if ipaddress.ip_address(host).is_loopback
        else "the network can reach it: put TLS in front of it, tokens travel in the clear"
    )
    return f"fploc: serving {names} on http://{shown}:{port} ({reach})"
