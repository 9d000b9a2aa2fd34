"""``fploc data``: the public data set, from its files to cards and an archive."""

from __future__ import annotations

from collections.abc import Mapping

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.data import archive, build, describe, download, verify
from fploc.commands.interface import Command
from fploc.commands.options import new_parser

MEANING = "Fetch, check, pack, describe and archive public data."
COMMANDS: Mapping[str, Command] = {
    "download": download,
    "verify": verify,
    "build": build,
    "describe": describe,
    "archive": archive,
}
NEEDS_ONE = True


def parser() -> ArgumentParser:
    """Return the parser, without the commands."""
    return new_parser(
        "The public data set: fetch, check, pack and describe it. "
        "Example: fploc data build --sites office,laboratory"
    )


def run(options: Namespace) -> None:
    """Do what the command of ``options`` says.

    Raises:
        FplocError: For any bad input.
    """
    COMMANDS[options.data_command].run(options[options.data_command])
