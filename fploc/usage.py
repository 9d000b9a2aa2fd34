"""What the command line says: its help, and why it refuses words, in one line and in the names that users type."""

from __future__ import annotations

import re
from argparse import SUPPRESS, Action, _SubParsersAction
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jsonargparse import DefaultHelpFormatter

KINDS = {"int": "whole number", "float": "finite number", "bool": "true or false", "str": "text"}

POSITIONAL = ("shell",)
HELP_OF_PARSER = {
    "help": "Show this and exit.",
    "version": "Print the version and exit.",
    "print_config": "Print these options as YAML and exit.",
}
"""Instead of the parser's own words."""
EXAMPLE = "Example: "


class ExampleFormatter(DefaultHelpFormatter):
    """Help with an example that stands on its own line, to be copied."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        meaning, _, example = text.partition(EXAMPLE)
        filled = super()._fill_text(meaning.strip(), width, indent)
        return f"{filled}\n\nExample:\n  {example}" if example else filled


class HelpFormatter(ExampleFormatter):
    """Help in the words of users: no types of Python, defaults as a sentence."""

    def _get_help_string(self, action: Action) -> str:
        said = HELP_OF_PARSER.get(action.dest, action.help or "")
        if action.required:
            return f"{said} Required."
        if (
            action.default in (None, "", SUPPRESS)
            or "default" in said.lower()
            or action.dest in HELP_OF_PARSER
        ):
            return said
        return f"{said} Default: %(default)s."

    def _format_usage(self, usage: str | None, actions: Iterable[Action], *args: Any) -> str:
        return super()._format_usage(usage, actions, *args).replace(" [options]", "")

    def add_text(self, text: str | None) -> None:
        """Take a text in; a blank one, which stands where the parser would say something itself, takes no line."""
        super().add_text(text if text is None or text.strip() else None)

    def add_argument(self, action: Action) -> None:
        """Take an action in; commands are indented, which the width of the column must allow for."""
        super().add_argument(action)
        if isinstance(action, _SubParsersAction):
            self._action_max_length += self._indent_increment * 2

    def _format_action_invocation(self, action: Action) -> str:
        return "" if isinstance(action, _SubParsersAction) else super()._format_action_invocation(action)

    def _format_action(self, action: Action) -> str:
        formatted = super()._format_action(action)
        # Of the list of commands, the line above it says nothing.
        return formatted.partition("\n")[2] if isinstance(action, _SubParsersAction) else formatted


def usage_message(reason: str, words: Sequence[str], commands: Mapping[str, Sequence[str]]) -> str:
    """Return why ``words`` were refused.

    Args:
        reason: As the parser puts it.
        words: Of the command line, without the program's name.
        commands: Names of the sub-commands, by the command that they follow; by "" the first ones.
    """
    said: list[str] = []
    for word in words:
        if word not in commands.get(said[-1] if said else "", ()):
            break
        said.append(word)
    text = " ".join(reason.split()).rstrip(".")
    known = ", ".join(commands.get(said[-1] if said else "", ()))
    text = re.sub(
        r'expected "[\w.]*command" to be one of .*, but it was not provided',
        f"found no command, expected one of {known}",
        text,
    )
    text = re.sub(
        r"argument COMMAND: invalid choice: (\S+) \(choose from .*\)",
        rf"found \1, expected one of {known}",
        text,
    )
    text = re.sub(r"\(choose from '', ", "(choose from ", text)
    text = re.sub(
        r"(?<=arguments are required: )[\w., -]+",
        lambda keys: ", ".join(_option(key, said) for key in keys[0].split(", ")),
        text,
    )
    text = re.sub(r'Parser key "([^"]+)":', lambda key: f"{_option(key[1], said)}:", text)
    text = re.sub(r"<class '(\w+)'>", lambda kind: KINDS.get(kind[1], kind[1]), text)
    return f"{text}; see `{' '.join(['fploc', *said])} --help`"


def _option(key: str, said: Sequence[str]) -> str:
    """Return the option that the parser keeps under ``key``."""
    for command in said:
        key = key.removeprefix(f"{command}.")
    if key in POSITIONAL:
        return key.upper()
    if said[:1] == ["fit"]:
        return f"--{key}"
    if key == "source" and said[:1] != ["synthesize"]:
        return "--from"
    return f"--{key.replace('_', '-')}"
