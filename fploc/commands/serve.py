"""``fploc serve``: the server of a building, and tokens for it."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from jsonargparse import ArgumentParser, Namespace

from fploc.commands import token
from fploc.commands.interface import Command
from fploc.commands.options import (
    add_config,
    add_data_root,
    add_database,
    add_trained,
    database_url,
    listed,
    new_parser,
)
from fploc.errors import FplocError

MEANING = "Take in what phones send, show where they are."
COMMANDS: Mapping[str, Command] = {"token": token}
NEEDS_ONE = False


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Take in what phones send, localize them every tick, show them on a map. "
        "Example: fploc serve --site shopping-mall"
    )
    add_config(parser)
    parser.add_argument(
        "--site", type=str | None, default=None, help="Packed sites, names or folders, commas between."
    )
    parser.add_argument("--model", type=str, default="default", help="Name of the method.")
    parser.add_argument("--calibration", type=str | None, default=None, help="none, source-los, … or metres.")
    parser.add_argument(
        "--speed-prior", type=float | None, default=None, help="Of people, m/s. Default: of the settings."
    )
    parser.add_argument(
        "--settings", type=str, default="default", help="Limits and times: conf/serve/NAME.yaml."
    )
    parser.add_argument("--host", type=str, default="127.0.0.1", help="Address to listen at.")
    parser.add_argument("--port", type=int, default=8000, help="Port to listen at; 0 takes a free one.")
    add_database(parser)
    add_data_root(parser)
    add_trained(parser)
    return parser


def run(options: Namespace) -> None:
    """Serve until interrupted, or make a token.

    Raises:
        FplocError: For any bad input.
    """
    if options.serve_command == "token":
        token.run(options.token)
        return
    if options.site is None:
        raise FplocError(
            "--site", value="nothing", expected="a packed site", way_out="write `fploc serve --site SITE`"
        )
    from fploc.serve.app import make_app
    from fploc.serve.models import ModelRequest, packed_place, served_site
    from fploc.serve.server import announcement, listening_socket, server_of
    from fploc.serve.settings import ServeSettings
    from fploc.serve.store import Store

    settings = ServeSettings.read(options.settings)
    speed_mps = settings.speed_prior_mps if options.speed_prior is None else options.speed_prior
    request = ModelRequest(
        options.model, options.calibration, speed_mps, options.preset, options.seed, options.runs
    )
    places = [packed_place(name, options.data_root) for name in listed(options.site)]
    sites = [served_site(root, name, request) for root, name in dict.fromkeys(places)]
    store = Store(database_url(options))
    with listening_socket(options.host, options.port) as listening:
        print(announcement(sites, listening), file=sys.stderr, flush=True)
        server_of(make_app(sites, store, settings), listening).run()
    store.close()
