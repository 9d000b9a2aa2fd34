"""Which revision of this project is running."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import fploc


@cache
def running_commit() -> str | None:
    """Return the git commit of the checkout that this package is run from; None for an installed wheel.

    Where files that git tracks were edited since, ``-dirty`` stands behind it.
    """
    root = Path(fploc.__file__).resolve().parents[1]
    lines = _git(root, "rev-parse", "--show-toplevel", "HEAD")
    if len(lines) != 2 or Path(lines[0]).resolve() != root:
        return None
    edited = _git(root, "status", "--porcelain", "--untracked-files=no")
    return f"{lines[1]}-dirty" if edited else lines[1]


def _git(folder: Path, *arguments: str) -> list[str]:
    """Return the lines that git printed; none where it is missing or refuses."""
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            check=False,
        )
    except FileNotFoundError:
        return []
    return done.stdout.split() if done.returncode == 0 else []
