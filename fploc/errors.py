"""Errors for bad input: each message names the thing, the value, what was expected and the way out."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class FplocError(Exception):
    """Base of every error that a user's input can cause; the command line prints it and exits with 2.

    Args:
        thing: What is wrong: a file with its row or column, an option, a key.
        value: What was found there.
        expected: What was expected instead.
        way_out: What the user can do next.
    """

    def __init__(self, thing: str, *, value: object, expected: str, way_out: str) -> None:
        self.thing, self.value, self.expected, self.way_out = thing, value, expected, way_out
        super().__init__(f"{thing}: found {value}, expected {expected}; {way_out}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the error again in another process, where subclasses take other arguments."""
        return _restored, (type(self), self.thing, self.value, self.expected, self.way_out)


class BadFileError(FplocError):
    """A file whose contents cannot be read as the kind that it should be."""

    def __init__(self, path: Path | str, where: str, *, value: object, expected: str, way_out: str) -> None:
        super().__init__(f"{path}, {where}", value=value, expected=expected, way_out=way_out)


class MissingFileError(FplocError):
    """A file or folder that should exist and does not."""

    def __init__(self, path: Path | str, *, expected: str, way_out: str) -> None:
        super().__init__(str(path), value="nothing", expected=expected, way_out=way_out)


class HashMismatchError(FplocError):
    """A file whose contents are not the ones that were promised."""

    def __init__(self, path: Path | str, *, algorithm: str, found: str, expected: str, way_out: str) -> None:
        super().__init__(f"{path} ({algorithm})", value=found, expected=expected, way_out=way_out)


class UnknownNameError(FplocError):
    """A name (site, method, protocol, MAC, …) that is not among the known ones."""

    def __init__(self, kind: str, name: object, *, known: list[str], way_out: str) -> None:
        super().__init__(kind, value=repr(name), expected=f"one of {', '.join(known)}", way_out=way_out)


class DownloadError(FplocError):
    """A file that could not be fetched."""


class MissingArtifactError(FplocError):
    """A trained artifact that has not been made, or was made from other data or settings."""


def _restored(kind: type[FplocError], thing: str, value: object, expected: str, way_out: str) -> FplocError:
    error = kind.__new__(kind)
    FplocError.__init__(error, thing, value=value, expected=expected, way_out=way_out)
    return error
