"""``fploc replay``: recordings, sent as phones would."""

from __future__ import annotations

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_config, add_data_root, add_printed_json, new_parser
from fploc.commands.printing import print_rows

MEANING = "Send recordings as phones would."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Send recordings of a packed site to a server, as phones would. "
        "Example: fploc replay --site shopping-mall --speed 5 --token fploc_…"
    )
    add_config(parser)
    parser.add_argument("--site", type=str, required=True, help="Packed site to take recordings from.")
    parser.add_argument("--device", type=str, default="all", help="1, 2 or all.")
    parser.add_argument(
        "--recordings", type=str | None, default=None, help="Names, commas between. Default: all."
    )
    parser.add_argument(
        "--phones", type=int | None, default=None, help="How many. Default: one for each recording."
    )
    parser.add_argument("--url", type=str, default="http://127.0.0.1:8000", help="Of the server.")
    parser.add_argument("--to", type=str | None, default=None, help="Site of the server. Default: --site.")
    parser.add_argument("--token", type=str | None, default=None, help="With the scope upload.")
    parser.add_argument("--speed", type=float, default=1.0, help="Seconds of the recording in one second.")
    parser.add_argument("--drop", type=float, default=0.0, help="Share of reading sets that get lost.")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="Longest delay of a reading set.")
    parser.add_argument("--seed", type=int, default=0, help="Of what is lost and late.")
    add_data_root(parser)
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Send them, and print what became of every phone's messages.

    Raises:
        FplocError: For any bad input.
    """
    import asyncio

    from fploc.serve.phones import Conditions, Server, send_walks
    from fploc.serve.replay import recorded_walks

    conditions = Conditions(options.speed, options.drop, options.delay_ms, options.seed)
    walks = recorded_walks(
        options.data_root, options.site, options.device, options.recordings, options.phones
    )
    server = Server(options.url, options.to or options.site, options.token)
    sent = asyncio.run(send_walks(server, walks, conditions))
    columns = ("accepted", "duplicate", "late", "skewed", "tried again")
    rows = [
        {"phone": one.device, "dropped": str(one.dropped)}
        | {name: str(one.outcomes[name]) for name in columns}
        for one in sent
    ]
    print_rows(rows, as_json=bool(options.json))
