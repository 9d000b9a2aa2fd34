"""Words that the command line refuses: why, in one line and in the names that users type."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

KINDS = {"int": "whole number", "float": "finite number", "bool": "true or false", "str": "text"}


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
        r"argument \w*command: invalid choice: (\S+) \(choose from .*\)",
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
    if said[:1] == ["fit"]:
        return f"--{key}"
    if key == "source" and said[:1] != ["synthesize"]:
        return "--from"
    return f"--{key.replace('_', '-')}"
