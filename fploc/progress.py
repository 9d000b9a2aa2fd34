"""What a person sees in a terminal: progress bars with time left (stderr), tables (stdout)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

WIDE = 200

Item = TypeVar("Item")


def track(items: Sequence[Item], description: str) -> Iterator[Item]:
    """Yield ``items`` and show how many are done and how long the rest will take; nothing inside of another."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with _one_at_a_time() as shown, Progress(*columns, console=_console(), disable=not shown) as progress:
        yield from progress.track(items, description=description)


@contextmanager
def busy(description: str) -> Iterator[None]:
    """Show for how long something is worked on whose end cannot be foreseen."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with (
        _one_at_a_time() as shown,
        Progress(*columns, console=_console(), disable=not shown, transient=True) as progress,
    ):
        progress.add_task(description, total=None)
        yield


_shown: list[bool] = []
"""What is shown now, the outermost first: lines of several would write over each other."""


@contextmanager
def _one_at_a_time() -> Iterator[bool]:
    shown = is_shown() and not any(_shown)
    _shown.append(shown)
    try:
        yield shown
    finally:
        _shown.remove(shown)


def _console() -> Console:
    return Console(stderr=True)


def is_shown() -> bool:
    """Return whether progress is shown: stderr is a terminal."""
    return _console().is_terminal


def hush_imports() -> None:
    """Leave out what packages announce to programmers while they are imported: call it before they are."""
    # torch_geometric scripts a function at import, which torch announces the end of.
    warnings.filterwarnings("ignore", message=".*torch.jit.script.*", category=FutureWarning)


def print_table(rows: Sequence[Mapping[str, str]]) -> None:
    """Print rows of equal keys as a table on stdout, as wide as it needs to be where that is no terminal."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDE)
    table = Table(box=SIMPLE_HEAD)
    for name in rows[0] if rows else ():
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(Text(value) for value in row.values()))
    console.print(table)
