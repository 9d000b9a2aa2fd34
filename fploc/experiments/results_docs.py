"""``make results``: docs/results.* from finished runs of the presets ``full`` and ``published``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from fploc.errors import MissingFileError
from fploc.evaluation.records import read_tracked_records, write_records
from fploc.evaluation.results_page import results_page
from fploc.experiments.reporting import FACTS, RECORDS
from fploc.files import whole

BASE, WIDE = "full", "published"
RATES, TIMINGS = "virtual-stream.json", "bench.json"
PLAN_WORTH, OFFLINE = "plan-worth.json", "offline.jsonl"
LOAD = "load.json"
"""In docs already: soak/load_page.py writes it."""
DOCUMENT = "results"


def update_docs(runs: Path, docs: Path) -> Path:
    """Write records, facts and page of the results below ``docs`` and return the page.

    Args:
        runs: Folder of runs; ``published``, the rates of virtual streams and the timings may be missing from it.
        docs: Folder of documents.

    Raises:
        MissingFileError: If the preset ``full`` was not run to its end.
    """
    presets = [name for name in (BASE, WIDE) if name == BASE or (runs / name / FACTS).is_file()]
    facts = {name: _facts(runs / name / FACTS) for name in presets}
    records = [one for name in presets for one in read_tracked_records(runs / name / RECORDS)]
    costs = [row | {"preset": name} for name, own in facts.items() for row in own["training_cost"]]
    joined = facts[BASE] | {"training_cost": costs, "virtual_rates": _rates(runs / RATES)}
    joined["timings"] = _rows(runs / TIMINGS)
    joined["plan_worth"] = _rows(runs / PLAN_WORTH)
    joined["offline"] = _lines(runs / OFFLINE)
    write_records(records, docs / f"{DOCUMENT}.jsonl")
    _write(docs / f"{DOCUMENT}-facts.json", json.dumps(joined, indent=1) + "\n")
    page = docs / f"{DOCUMENT}.md"
    _write(page, page_of(docs))
    return page


def page_of(docs: Path) -> str:
    """Return the results page that the records and facts below ``docs`` make, and the load that was measured."""
    records = read_tracked_records(docs / f"{DOCUMENT}.jsonl")
    facts = json.loads((docs / f"{DOCUMENT}-facts.json").read_text(encoding="utf-8"))
    load = docs / LOAD
    curve = json.loads(load.read_text(encoding="utf-8"))["curve"] if load.is_file() else []
    return results_page(records, facts | {"load_curve": curve})


def _facts(file: Path) -> dict[str, Any]:
    if not file.is_file():
        preset = file.parent.name
        raise MissingFileError(
            file, expected="facts of a finished run", way_out=f"run `fploc reproduce --preset {preset}`"
        )
    return dict(json.loads(file.read_text(encoding="utf-8")))


def _rates(file: Path) -> dict[str, float]:
    """Return links per second by what was measured."""
    return {
        f"{row['network']} on {row['site']}, threads: {row['threads']}": row["links_per_s"]
        for row in _rows(file)
    }


def _rows(file: Path) -> list[dict[str, Any]]:
    """Return the rows of a benchmark; none where it was not run."""
    return list(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else []


def _lines(file: Path) -> list[dict[str, Any]]:
    """Return the records that `fploc evaluate --json FILE` wrote; none where it was not run."""
    return (
        [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.is_file() else []
    )


def _write(file: Path, text: str) -> None:
    with whole(file) as part:
        part.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    print(update_docs(Path(sys.argv[1]), Path(sys.argv[2])))  # noqa: T201
