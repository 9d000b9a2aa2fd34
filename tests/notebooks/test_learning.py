"""Notebooks 03 and 05: trainings of seconds, and what comes out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import nbformat

Execute = Callable[[str, Path, Path], nbformat.NotebookNode]
Outputs = Callable[[nbformat.NotebookNode, str], list[str]]


def test_the_chain_is_trained_and_looked_into(
    notebook_data: Path, tmp_path: Path, execute: Execute, outputs: Outputs
) -> None:
    notebook = execute("03", notebook_data, tmp_path)
    maps, trajectories, crop, attention = 2, 1, 1, 1
    assert len(outputs(notebook, "image/png")) == maps + trajectories + crop + attention
    ranges, positions = outputs(notebook, "text/markdown")
    assert "| ranges, FPDNN |" in ranges and "| GNN + FPDNN + KF |" in positions
    assert not list(tmp_path.iterdir()), "runs are read, never written"


def test_a_building_of_ones_own_is_localized_without_measuring_it(
    notebook_data: Path, tmp_path: Path, execute: Execute, outputs: Outputs
) -> None:
    before = sorted(path.name for path in (notebook_data / "packed").iterdir())
    notebook = execute("05", notebook_data, tmp_path)
    (table,) = outputs(notebook, "text/markdown")
    rows = [row.split(" | ") for row in table.splitlines()[2:]]
    methods = ["trilateration", "nls", "gnn-fpdnn"]
    assert [row[0].removeprefix("| ") for row in rows] == [method for method in methods for _ in (1, 2)]
    assert all(0.0 < float(row[2]) < 20.0 for row in rows)
    overlay, tracks, cdf = 1, 1, 1
    assert len(outputs(notebook, "image/png")) == overlay + tracks + cdf
    assert sorted(path.name for path in (notebook_data / "packed").iterdir()) == before
