"""Notebooks run on a miniature of what ``make reproduce`` writes, made from made-up buildings."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.errors import MissingFileError
from fploc.evaluation.error_series import error_series, write_error_series
from fploc.evaluation.evaluate import EvaluationRequest, records_of, source_offsets, tracks_of
from fploc.evaluation.records import TrackedRecord, write_records
from fploc.evaluation.report import comparison_rows
from fploc.evaluation.tables import markdown
from fploc.experiments.plan import Scoring
from fploc.experiments.scoring import data_hash
from fploc.methods.registry import GEOMETRIC_METHODS, geometric_method
from fploc.sites.made_up import made_up_site

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
RESULTS = next(path for path in NOTEBOOKS if path.name == "04-results.ipynb")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def tracked(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> list[TrackedRecord]:
    return write_runs(runs, tmp_path_factory.mktemp("data"))


def write_runs(runs: Path, data_root: Path) -> list[TrackedRecord]:
    """Write records and errors of two methods at one made-up building; two presets, the default older."""
    files = [made_up_site(seed, data_root / "made-up", laps=2, duration_s=30.0) for seed in (1, 2)]
    source, target = (report.site for report in build_sites(None, data_root, files))
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


def executed(path: Path) -> nbformat.NotebookNode:
    notebook = nbformat.read(path, as_version=4)
    folder = {"metadata": {"path": str(path.parent)}}
    return NotebookClient(notebook, timeout=120, kernel_name="python3", resources=folder).execute()


def outputs(notebook: nbformat.NotebookNode, kind: str) -> list[str]:
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [output["data"][kind] for output in shown if kind in output.get("data", {})]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebook_teaches_and_defines_nothing(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.cells[0].cell_type == "markdown"
    assert "you will learn" in notebook.cells[0].source
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code), "strip it: nbstripout"
    lines = [line.lstrip() for cell in code for line in cell.source.splitlines()]
    assert not [line for line in lines if line.startswith(("def ", "class ", "async def "))]


def test_results_notebook_shows_table_bars_and_cdfs(
    runs: Path, tracked: list[TrackedRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FPLOC_RUNS", str(runs))
    notebook = executed(RESULTS)
    texts = "\n".join(outputs(notebook, "text/markdown"))
    for labels in ("repaired", "published"):
        assert markdown(comparison_rows(tracked, labels=labels)).strip() in texts
    assert "Made-up buildings: no real data." in texts
    assert "`run-nls`" in texts
    bars, cdfs = 2, 2
    assert len(outputs(notebook, "image/png")) == bars + cdfs


def test_results_notebook_without_results_says_what_to_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FPLOC_RUNS", str(tmp_path))
    with pytest.raises(Exception, match="make reproduce") as caught:
        executed(RESULTS)
    assert MissingFileError.__name__ in str(caught.value)
