"""Stages that other processes can run: ``test_stages.py`` puts this folder on the path, so that they find it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from fploc.errors import UnknownNameError
from fploc.experiments.stages import Stage

PATIENCE_S = 30.0


def chain(folder: Path) -> list[Stage]:
    """Two independent numbers, each doubled, and the sum of both."""
    return [
        stage(folder, "three", (), partial(_write, folder / "three", 3)),
        stage(folder, "five", (), partial(_write, folder / "five", 5)),
        stage(folder, "twice-three", ("three",), partial(_add, folder, "twice-three", "three", "three")),
        stage(folder, "twice-five", ("five",), partial(_add, folder, "twice-five", "five", "five")),
        stage(
            folder,
            "sum",
            ("twice-three", "twice-five"),
            partial(_add, folder, "sum", "twice-three", "twice-five"),
        ),
    ]


def meeting(folder: Path) -> list[Stage]:
    """Two stages, each of which ends only when the other has begun."""
    return [
        stage(folder, "left", (), partial(_meet, folder, "left", "right")),
        stage(folder, "right", (), partial(_meet, folder, "right", "left")),
    ]


def failing(folder: Path) -> list[Stage]:
    """One stage that ends, one that waits to be interrupted, one that fails as soon as that waits."""
    return [
        stage(folder, "quick", (), partial(_write, folder / "quick", 1)),
        stage(folder, "slow", (), partial(_wait_for_the_end, folder)),
        stage(folder, "bad", ("quick",), partial(_fail, folder)),
        stage(folder, "later", ("bad",), partial(_write, folder / "later", 2)),
    ]


def waiting(folder: Path) -> list[Stage]:
    """One stage that waits to be interrupted."""
    return [stage(folder, "slow", (), partial(_wait_for_the_end, folder))]


def counted(folder: Path) -> list[Stage]:
    """One stage that notes how many threads libraries of numbers may start."""
    return [stage(folder, "threads", (), partial(_note_threads, folder / "threads"))]


def stage(folder: Path, name: str, after: tuple[str, ...], work: Callable[[], None]) -> Stage:
    """Return a stage whose output is the file of its name."""
    return Stage(name=name, inputs=("a",), outputs=(folder / name,), after=after, run=work)


def run(make: Callable[[Path], list[Stage]], folder: Path, name: str) -> None:
    """Run the stage ``name`` of those that ``make`` makes."""
    {one.name: one for one in make(folder)}[name].run()


def wait_for(file: Path) -> None:
    """Return when ``file`` is there."""
    until = time.monotonic() + PATIENCE_S
    while not file.exists():
        assert time.monotonic() < until, f"{file} never came"
        time.sleep(0.02)


def _write(file: Path, number: int) -> None:
    file.write_text(str(number))


def _add(folder: Path, name: str, one: str, other: str) -> None:
    _write(folder / name, int((folder / one).read_text()) + int((folder / other).read_text()))


def _meet(folder: Path, own: str, other: str) -> None:
    (folder / own).write_text(str(os.getpid()))
    wait_for(folder / other)


def _wait_for_the_end(folder: Path) -> None:
    try:
        (folder / "slow-began").touch()
        wait_for(folder / "never")
    except KeyboardInterrupt:
        (folder / "slow-interrupted").touch()
        raise


def _fail(folder: Path) -> None:
    wait_for(folder / "slow-began")
    raise UnknownNameError("--plan", "moon", known=["real", "blank"], way_out="choose one of these")


def _note_threads(file: Path) -> None:
    file.write_text(os.environ["OMP_NUM_THREADS"])
