"""Messages of errors, and that they survive the way from one process to another."""

from __future__ import annotations

import importlib
import pickle
import re
from pathlib import Path

import pytest

import fploc
from fploc.errors import (
    BadFileError,
    DownloadError,
    FplocError,
    HashMismatchError,
    MissingArtifactError,
    MissingFileError,
    UnknownNameError,
)

PLAIN = {"value": 3, "expected": "1 or 2", "way_out": "write 1"}
MADE = [
    FplocError("--device", **PLAIN),
    BadFileError(Path("a.csv"), "row 7", **PLAIN),
    MissingFileError("packed/moon", expected="a packed site", way_out="build it"),
    HashMismatchError("a.csv", algorithm="sha256", found="00", expected="ff", way_out="fetch it again"),
    UnknownNameError("--plan", "moon", known=["real", "blank"], way_out="choose one of these"),
    DownloadError("https://example.invalid/a.csv", **PLAIN),
    MissingArtifactError("runs/artifacts/x", **PLAIN),
]


def every_kind() -> set[type[FplocError]]:
    """Return all subclasses, wherever in the package they are defined."""
    package = Path(fploc.__file__).parent
    for file in sorted(package.rglob("*.py")):
        if re.search(r"^class \w+\(.*Error\)", file.read_text(encoding="utf-8"), re.MULTILINE):
            importlib.import_module(".".join(("fploc", *file.relative_to(package).with_suffix("").parts)))
    kinds, new = {FplocError}, [FplocError]
    while new:
        new = [kind for parent in new for kind in parent.__subclasses__() if kind not in kinds]
        kinds.update(new)
    return kinds


@pytest.mark.parametrize("error", MADE, ids=lambda error: type(error).__name__)
def test_a_message_names_thing_value_expectation_and_way_out(error: FplocError) -> None:
    told = str(error)
    assert told == f"{error.thing}: found {error.value}, expected {error.expected}; {error.way_out}"
    assert "\n" not in told


@pytest.mark.parametrize("kind", sorted(every_kind(), key=lambda kind: kind.__name__))
def test_every_error_arrives_in_another_process_as_it_was(kind: type[FplocError]) -> None:
    made = next((one for one in MADE if type(one) is kind), None)
    if made is None:
        made = kind.__new__(kind)
        FplocError.__init__(made, "--from", **PLAIN)
    arrived = pickle.loads(pickle.dumps(made))
    assert type(arrived) is kind and str(arrived) == str(made)
    told = ("thing", "value", "expected", "way_out")
    assert [getattr(arrived, name) for name in told] == [getattr(made, name) for name in told]
