"""What the module of a sub-command has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from jsonargparse import ArgumentParser, Namespace


class Listed(Protocol):
    """A sub-command in the list of ``fploc --help``."""

    @property
    def MEANING(self) -> str:
        """Its line in the list."""

    def parser(self) -> ArgumentParser:
        """Return the parser of its options."""


class Command(Listed, Protocol):
    """A sub-command that does something with its options."""

    def run(self, options: Namespace) -> None:
        """Do it.

        Args:
            options: Its own, without those of other commands.

        Raises:
            FplocError: For any bad input.
        """


class Group(Command, Protocol):
    """A sub-command that has sub-commands itself."""

    @property
    def COMMANDS(self) -> Mapping[str, Command]:
        """These, by name."""

    @property
    def NEEDS_ONE(self) -> bool:
        """False where the command means something without one of them."""
