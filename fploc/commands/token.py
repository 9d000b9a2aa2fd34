"""``fploc serve token``: tokens of a server."""

from __future__ import annotations

import time

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_database, database_url, new_parser
from fploc.errors import UnknownNameError

MEANING = "Make a token for a phone or a reader."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Make a token; it is shown once. Example: fploc serve token --name phone-7 --scope upload"
    )
    parser.add_argument("--name", type=str, default="token", help="What it is for.")
    parser.add_argument("--scope", type=str, default="upload", help="upload, read, admin; commas between.")
    parser.add_argument("--days", type=float, default=365.0, help="How long it is valid.")
    parser.add_argument(
        "--expire", type=str | None, default=None, help="Id of a token that ends now instead."
    )
    add_database(parser)
    return parser


def run(options: Namespace) -> None:
    """Print a new token, or end one.

    Raises:
        UnknownNameError: If the token to end is unknown.
        FplocError: If the database cannot be used, or scopes or days are none.
    """
    from fploc.serve.store import Store
    from fploc.serve.tokens import make_token, scopes_of

    store = Store(database_url(options))
    now_ms = time.time() * 1000.0
    if options.expire is None:
        print(make_token(store, options.name, scopes_of(options.scope), options.days, now_ms))
    elif not store.expire_token(options.expire, now_ms):
        known = [token.id for token in store.tokens()]
        raise UnknownNameError(
            "--expire", options.expire, known=known, way_out="the id is between the underscores of a token"
        )
    store.close()
