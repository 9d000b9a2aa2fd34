"""Options that several sub-commands share."""

from __future__ import annotations

import os
from pathlib import Path

from jsonargparse import ActionConfigFile, ArgumentParser, Namespace

DATA_VARIABLE = "FPLOC_DATA"
PRINTED = "-"


def new_parser(description: str) -> ArgumentParser:
    """Return a parser without options; what follows ``Example:`` in its description stands on its own line."""
    return ArgumentParser(description=description, exit_on_error=False)


def add_config(parser: ArgumentParser) -> None:
    """Let all options stand in a file, too."""
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")


def add_data_root(parser: ArgumentParser) -> None:
    """Add the folder of the data."""
    parser.add_argument(
        "--data-root",
        type=Path,
        default=Path(os.environ.get(DATA_VARIABLE, "data")),
        help="Folder of the data. Default: FPLOC_DATA, else ./data.",
    )


def add_public_data(parser: ArgumentParser) -> None:
    """Add where public files come from, the folder of the data, and of which sites."""
    parser.add_argument(
        "--from",
        type=Path | None,
        dest="source",
        default=None,
        help="Local copy of the public files, laid out <revision>/<path>. Default: FPLOC_SOURCE.",
    )
    add_data_root(parser)
    parser.add_argument(
        "--sites",
        type=str | None,
        default=None,
        help="Names, separated by commas, or site files. Default: all.",
    )


def data_parser(description: str) -> ArgumentParser:
    """Return a parser with what all of ``fploc data`` take."""
    parser = new_parser(description)
    add_config(parser)
    add_public_data(parser)
    return parser


def listed(text: str) -> list[str]:
    """Return names with commas between."""
    return [name.strip() for name in text.split(",")]


def add_trained(parser: ArgumentParser) -> None:
    """Add which trained artifacts are taken."""
    parser.add_argument("--seed", type=int, default=0, help="Seed of the trained artifact.")
    parser.add_argument("--preset", type=str, default="default", help="Preset of the trained artifact.")
    add_artifacts(parser)


def add_artifacts(parser: ArgumentParser) -> None:
    """Add the folder of runs that trained artifacts lie in."""
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")


def add_printed_json(parser: ArgumentParser) -> None:
    """Let the answer be JSON."""
    parser.add_argument(
        "--json",
        type=str,
        nargs="?",
        const=PRINTED,
        choices=["", PRINTED],
        metavar=PRINTED,
        default="",
        help="Print JSON instead of a table; --json - is the same.",
    )


def add_database(parser: ArgumentParser) -> None:
    """Add where a server keeps its state."""
    parser.add_argument(
        "--state", type=Path, default=Path("runs/serve"), help="Folder of the database, where none is named."
    )
    parser.add_argument(
        "--database", type=str | None, default=None, help="URL: sqlite:////folder/file.db or postgresql://…"
    )


def database_url(options: Namespace) -> str:
    """Return the URL of the database that the options of ``add_database`` name."""
    from fploc.serve.store import sqlite_url

    return sqlite_url(options.state) if options.database is None else str(options.database)
