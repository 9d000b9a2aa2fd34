"""All sub-commands of ``fploc``, and its parser."""

from __future__ import annotations

from collections.abc import Mapping

from jsonargparse import ArgumentParser

from fploc import __version__
from fploc.commands import (
    bench,
    completion,
    data,
    evaluate,
    fit,
    made_up,
    model,
    replay,
    reproduce,
    serve,
    synthesize,
    tune,
)
from fploc.commands.interface import Command, Group, Listed
from fploc.usage import HelpFormatter

GROUPS: Mapping[str, Group] = {"data": data, "serve": serve}
COMMANDS: Mapping[str, Command] = {
    "data": data,
    "made-up": made_up,
    "evaluate": evaluate,
    "reproduce": reproduce,
    "tune": tune,
    "model": model,
    "synthesize": synthesize,
    "bench": bench,
    "serve": serve,
    "replay": replay,
    "completion": completion,
}
"""In the order in which they are met."""
FIT = "fit"
LISTED: Mapping[str, Listed] = {**COMMANDS, FIT: fit}
NAMES: Mapping[str, tuple[str, ...]] = {
    "": tuple(LISTED),
    **{name: tuple(group.COMMANDS) for name, group in GROUPS.items()},
}
"""Names of sub-commands by the command that they follow."""


def make_parser() -> ArgumentParser:
    """Return the parser of every sub-command but ``fit``, which is Lightning's own."""
    parser = ArgumentParser(
        prog="fploc",
        description="Find people and things indoors from WiFi round-trip time and a floor plan. "
        "Example: fploc made-up --seed 7 --out building",
        version=__version__,
        exit_on_error=False,
        formatter_class=HelpFormatter,
    )
    parsers = _added(parser, "command", LISTED, required=True)
    for name, group in GROUPS.items():
        _added(parsers[name], f"{name}_command", group.COMMANDS, required=group.NEEDS_ONE)
    return parser


def _added(
    parser: ArgumentParser, dest: str, listed: Mapping[str, Listed], *, required: bool
) -> Mapping[str, ArgumentParser]:
    """Add sub-commands to ``parser``, and return the parser of each."""
    commands = parser.add_subcommands(
        required=required,
        dest=dest,
        title=f"commands (`{parser.prog} COMMAND --help` explains each)",
        description=" ",
        metavar="COMMAND",
    )
    parsers = {name: one.parser() for name, one in listed.items()}
    for name, own in parsers.items():
        commands.add_subcommand(name, own, help=listed[name].MEANING)
        own.prog = f"{parser.prog} {name}"
    return parsers
