"""Notebook 04 on a miniature of what ``make reproduce`` writes, and on the committed records."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import nbformat
import pytest

from fploc.datasets.packed import read_packed
from fploc.datasets.pages import markdown_grid
from fploc.errors import MissingFileError
from fploc.evaluation.error_series import error_series, write_error_series
from fploc.evaluation.evaluate import EvaluationRequest, records_of, source_offsets, tracks_of
from fploc.evaluation.records import TrackedRecord, write_records
from fploc.evaluation.report import comparison_rows
from fploc.evaluation.tables import UNKNOWN
from fploc.experiments.plan import Scoring
from fploc.experiments.scoring import data_hash
from fploc.methods.registry import GEOMETRIC_METHODS, geometric_method

PAGE = Path(__file__).parents[2] / "docs" / "results.md"
LABELS = ("repaired", "published")

Execute = Callable[[str, Path, Path], nbformat.NotebookNode]
Outputs = Callable[[nbformat.NotebookNode, str], list[str]]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def tracked(runs: Path, notebook_data: Path) -> list[TrackedRecord]:
    return write_runs(runs, notebook_data)


@pytest.fixture(scope="module")
def notebook(
    runs: Path, tracked: list[TrackedRecord], notebook_data: Path, execute: Execute
) -> nbformat.NotebookNode:
    return execute("04", notebook_data, runs)


def write_runs(runs: Path, data_root: Path) -> list[TrackedRecord]:
    """Write records and errors of two methods at one made-up building; two presets, the default older."""
    source, target = "made-up-1", "made-up-2"
    packed = [read_packed(data_root, site) for site in (source, target)]
    request = EvaluationRequest(protocol="zero-shot", site=target, source=source)
    offsets = source_offsets(request, data_root)
    scores = runs / "default" / "scores"
    scores.mkdir(parents=True)
    tracked = []
    for method in list(GEOMETRIC_METHODS)[:2]:
        tracks = tracks_of(geometric_method(method), request, data_root, offsets=offsets)
        records = records_of(method, request, tracks)
        tracked += [
            TrackedRecord(record, run_id=f"run-{method}", data_hash=data_hash(*packed), made_up=True)
            for record in records
        ]
        series = [error_series(track, "repaired") for track in tracks]
        write_error_series(series, scores / f"{Scoring(method, 'zero-shot', target, 0).name}.npz")
    write_records(tracked, runs / "default" / "records.jsonl")
    (runs / "smoke").mkdir()
    (runs / "smoke" / "records.jsonl").write_text("no record: default comes first\n", encoding="utf-8")
    return tracked


def cells(table: str) -> list[list[str]]:
    """Return the cells of a Markdown table, its head first."""
    lines = [line for line in table.splitlines() if line.startswith("| ") and not line.startswith("| ---")]
    return [line.removeprefix("| ").removesuffix(" |").split(" | ") for line in lines]


def rmse_of_the_page(labels: str) -> dict[tuple[str, ...], str]:
    """Return every filtered RMSE of the committed page that stands under no condition, by what it is of."""
    found = {}
    parts = re.split(r"^### ", PAGE.read_text("utf-8").partition("\n## All methods\n")[2], flags=re.MULTILINE)
    for part in parts:
        title, _, text = part.partition("\n")
        match = re.fullmatch(rf"(\S+): with KF, {labels} labels, RMSE", title)
        if match:
            head, *rows = cells(text)
            for row in rows:
                named = dict(zip(head, row, strict=True))
                if named.pop("condition", UNKNOWN) == UNKNOWN:
                    method = named.pop("method")
                    found |= {
                        (match[1], *place.split(" "), method): value
                        for place, value in named.items()
                        if value != UNKNOWN
                    }
    return found


def test_results_notebook_shows_table_bars_and_cdfs(
    notebook: nbformat.NotebookNode, tracked: list[TrackedRecord], outputs: Outputs
) -> None:
    texts = "\n".join(outputs(notebook, "text/markdown"))
    for labels in LABELS:
        assert markdown_grid(comparison_rows(tracked, labels=labels)).strip() in texts
    assert "Made-up buildings: no real data." in texts
    assert "`run-nls`" in texts
    bars, cdfs = 2, 2
    assert len(outputs(notebook, "image/png")) == bars + cdfs


@pytest.mark.parametrize("labels", LABELS)
def test_notebook_and_results_page_agree_to_the_last_digit(
    notebook: nbformat.NotebookNode, outputs: Outputs, labels: str
) -> None:
    title = f"### Committed, {labels} labels"
    (table,) = (text for text in outputs(notebook, "text/markdown") if text.startswith(title))
    _, *rows = cells(table)
    shown = {tuple(row[:4]): row[4] for row in rows if row[4] != UNKNOWN}
    assert len(shown) > 50 and shown == rmse_of_the_page(labels)


def test_results_notebook_without_results_says_what_to_run(
    tmp_path: Path, notebook_data: Path, execute: Execute
) -> None:
    with pytest.raises(Exception, match="make reproduce") as caught:
        execute("04", notebook_data, tmp_path)
    assert MissingFileError.__name__ in str(caught.value)
