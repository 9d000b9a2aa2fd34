"""Notebooks 01 and 02: the data, the plan and the crops."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import nbformat

from fploc.sites.registry import known_sites, load_spec

Execute = Callable[[str, Path, Path], nbformat.NotebookNode]
Outputs = Callable[[nbformat.NotebookNode, str], list[str]]

SITES = 2


def test_raw_data_shows_walls_and_names_every_fault(
    notebook_data: Path, tmp_path: Path, execute: Execute, outputs: Outputs
) -> None:
    notebook = execute("01", notebook_data, tmp_path)
    texts = "\n".join(outputs(notebook, "text/markdown"))
    for site in known_sites():
        for fault in load_spec(site).faults:
            assert f"| {fault.where} | {fault.what} |" in texts
    assert "| made-up-1 (made up) | 1 | 5 |" in texts
    link, walls, overlays, heard, steps = 1, 1, SITES, SITES, SITES
    assert len(outputs(notebook, "image/png")) == link + walls + overlays + heard + steps


def test_plan_and_crops_are_shown_as_ours_and_the_papers(
    notebook_data: Path, tmp_path: Path, execute: Execute, outputs: Outputs
) -> None:
    notebook = execute("02", notebook_data, tmp_path)
    overlay, free, links, paper, distorted, blank, elsewhere = 1, 1, 2, 1, 3, 1, 1
    shown = outputs(notebook, "image/png")
    assert len(shown) == overlay + free + links + paper + distorted + blank + elsewhere
    tables = outputs(notebook, "text/markdown")
    assert len(tables) == 2 and "| AP1 |" in tables[0] and "| tokens |" in tables[1]
