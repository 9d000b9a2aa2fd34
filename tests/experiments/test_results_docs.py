from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fploc.errors import MissingFileError
from fploc.evaluation.records import TrackedRecord, read_tracked_records, write_records
from fploc.experiments.results_docs import page_of, update_docs

MakeRecord = Callable[..., TrackedRecord]


def finished(made: MakeRecord, runs: Path, preset: str, facts: dict[str, Any]) -> None:
    """Leave behind what a finished run of a preset leaves, with one record."""
    (runs / preset).mkdir(parents=True)
    write_records([made(preset=preset)], runs / preset / "records.jsonl")
    (runs / preset / "facts.json").write_text(json.dumps(facts))


def test_runs_are_joined_and_costs_say_whose_they_are(made: MakeRecord, tmp_path: Path) -> None:
    runs, docs = tmp_path / "runs", tmp_path / "docs"
    docs.mkdir()
    finished(
        made,
        runs,
        "full",
        {"training_cost": [{"stage": "train--a", "seconds": 3.0}], "ablations": {"x": "why"}},
    )
    finished(
        made, runs, "published", {"training_cost": [{"stage": "train--b", "seconds": 4.0}], "ablations": {}}
    )
    rate = {"network": "generator", "site": "office", "threads": 1, "links_per_s": 5000.0}
    (runs / "virtual-stream.json").write_text(json.dumps([rate]))
    page = update_docs(runs, docs)
    assert page.read_text(encoding="utf-8") == page_of(docs)
    assert [one.record.preset for one in read_tracked_records(docs / "results.jsonl")] == [
        "full",
        "published",
    ]
    facts = json.loads((docs / "results-facts.json").read_text())
    assert [(row["preset"], row["seconds"]) for row in facts["training_cost"]] == [
        ("full", 3.0),
        ("published", 4.0),
    ]
    assert facts["ablations"] == {"x": "why"}
    assert facts["virtual_rates"] == {"generator on office, threads: 1": 5000.0}


def test_the_page_shows_the_load_that_was_measured(made: MakeRecord, tmp_path: Path) -> None:
    finished(made, tmp_path, "full", {"training_cost": [], "ablations": {}})
    without = update_docs(tmp_path, tmp_path).read_text(encoding="utf-8")
    committed = Path(__file__).parents[2] / "docs" / "load.json"
    (tmp_path / "load.json").write_bytes(committed.read_bytes())
    shown = page_of(tmp_path)
    for row in json.loads(committed.read_text(encoding="utf-8"))["curve"]:
        line = f"| {row['method']} | {row['devices']} |"
        assert line in shown and line not in without


def test_the_page_shows_what_the_benchmarks_wrote(made: MakeRecord, tmp_path: Path) -> None:
    finished(made, tmp_path, "full", {"training_cost": [], "ablations": {}})
    worth = {"site": "library", "what": "plan", "changed": "none"}
    worth |= {"device 1, RMSE [m]": "0.81", "device 2, RMSE [m]": "1.52"}
    (tmp_path / "plan-worth.json").write_text(json.dumps([worth]))
    offline = replace(made().record, method="default", filter="own", smoother=True, rmse_m=0.591)
    write_records([offline], tmp_path / "offline.jsonl")
    page = update_docs(tmp_path, tmp_path).read_text(encoding="utf-8")
    assert "| plan | none | 0.81/1.52 |" in page
    assert "| 0.59 |" in page.split("## Offline")[1].split("\n## ")[0]


def test_a_missing_run_names_the_command_that_makes_it(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="fploc reproduce --preset full"):
        update_docs(tmp_path, tmp_path)


def test_the_committed_page_is_what_the_committed_records_make() -> None:
    docs = Path(__file__).parents[2] / "docs"
    assert (docs / "results.md").read_text(encoding="utf-8") == page_of(docs)
