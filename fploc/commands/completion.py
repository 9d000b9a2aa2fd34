"""``fploc completion``: scripts for shells."""

from __future__ import annotations

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import new_parser

SHELLS = ("bash", "zsh")
MEANING = "Print what makes a shell complete these words."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Print the script that makes a shell complete sub-commands, options and names. "
        "Example: fploc completion bash > ~/.local/share/bash-completion/completions/fploc"
    )
    parser.add_argument("shell", type=str, choices=SHELLS, help="bash or zsh.")
    return parser


def run(options: Namespace) -> None:
    """Print the script.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.commands.registry import make_parser
    from fploc.completion import completion_script

    print(completion_script(make_parser(), options.shell), end="")
