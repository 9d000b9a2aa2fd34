"""``fploc fit``: training of one network. Its words are Lightning's."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout

from jsonargparse import ArgumentParser

from fploc.commands.options import PRINTED
from fploc.commands.printing import print_values

MEANING = "Train one network (LightningCLI)."


def parser() -> ArgumentParser:
    """Return a parser without options, for the list of commands: Lightning has its own."""
    return ArgumentParser(exit_on_error=False)


def run_words(words: Sequence[str]) -> None:
    """Train the network that ``words`` describe, and print where its artifact lies.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.experiments.fit import fit_from_command_line

    # All other words are Lightning's.
    ours = argparse.ArgumentParser(prog="fploc fit", add_help=False, allow_abbrev=False, exit_on_error=False)
    ours.add_argument("--json", nargs="?", const=PRINTED, choices=[PRINTED], default="")
    options, kept = ours.parse_known_args(words)
    as_json = bool(options.json)
    # Lightning's bars and summaries are notes where JSON was asked for.
    with redirect_stdout(sys.stderr if as_json else sys.stdout):
        fitted = fit_from_command_line(kept)
    if fitted is None:
        return
    if as_json:
        print_values({"artifact": fitted.artifact, "validation": dict(fitted.validation)}, as_json=True)
    elif fitted.artifact is not None:
        print(f"artifact: {fitted.artifact}")
