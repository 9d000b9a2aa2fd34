"""Tables of result records, ours beside the paper's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.paper_numbers import paper_numbers, published
from fploc.evaluation.records import Record

METRICS = ("rmse_m", "rmse_fixed_m", "p50_m", "p90_m")
UNKNOWN = "–"
FILTERS = {"none": "none", "kalman": "KF", "own": "own"}
SHARED_FLOOR = ("conference-room", "office-position1", "office-position2")


@dataclass(frozen=True)
class Scoring:
    """One thing to score: a method at a site, as one run of the log."""

    method: str
    protocol: str
    site: str
    seed: int

    @property
    def name(self) -> str:
        """Name of its stage, file and run."""
        return f"{self.protocol}--{self.site}--{self.method}--seed-{self.seed}"


@dataclass(frozen=True)
class TrackedRecord:
    """A result record and what it came from.

    Args:
        record: The record.
        run_id: Of the MLflow run that holds it.
        data_hash: Over the packed sites of source and target.
        made_up: True where the buildings are made up.
    """

    record: Record
    run_id: str
    data_hash: str
    made_up: bool

    def as_json(self) -> dict[str, Any]:
        """Return one line of a records file: the record's fields, then the others."""
        return self.record.as_json() | {
            "run_id": self.run_id,
            "data_hash": self.data_hash,
            "made_up": self.made_up,
        }


def tracked_record(line: str) -> TrackedRecord:
    """Return the record of one line of a records file.

    Raises:
        ValueError, KeyError, TypeError: If the line holds none.
    """
    values = json.loads(line)
    own = {name: values.pop(name) for name in ("run_id", "data_hash", "made_up")}
    return TrackedRecord(Record(**values), **own)


def read_tracked_records(path: Path) -> list[TrackedRecord]:
    """Return the records of a file of JSON lines.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If a line is no such record.
    """
    if not path.is_file():
        raise MissingFileError(path, expected="result records", way_out="make them: fploc reproduce")
    lines = path.read_text(encoding="utf-8").splitlines()
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            records.append(tracked_record(line))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BadFileError(
                path,
                f"line {number}",
                value=f"{type(error).__name__} {error}",
                expected="a result record as JSON",
                way_out="make it again: fploc reproduce",
            ) from error
    return records


def comparison_rows(records: Sequence[TrackedRecord], *, labels: str) -> list[dict[str, str]]:
    """Return methods × sites × devices × {unfiltered, KF}, means over seeds, the paper's RMSE beside.

    Args:
        records: Of one preset.
        labels: Kind of labels that the rows are scored with.
    """
    groups: dict[tuple[str, str, int, str, str], list[Record]] = {}
    for tracked in records:
        one = tracked.record
        if one.labels == labels:
            key = (one.protocol, one.site, one.device, one.method, one.filter)
            groups.setdefault(key, []).append(one)
    return [_row(*key, group) for key, group in groups.items()]


def markdown(rows: Sequence[dict[str, str]]) -> str:
    """Return rows of equal keys as a Markdown table."""
    if not rows:
        return ""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def page(records: Sequence[TrackedRecord], *, preset: str) -> str:
    """Return the results of one preset as a Markdown page."""
    made_up = any(tracked.made_up for tracked in records)
    revisions = ", ".join(sorted({tracked.record.commit or "unknown" for tracked in records}))
    notice = (
        "**Made-up buildings.** The public data could not be reached: nothing here says anything about "
        "the public sites or the paper.\n\n"
        if made_up
        else "The local sites are development sites: methods were chosen looking at them. "
        "Repaired labels used RTT in part and favour methods that trust it; both kinds stand below.\n\n"
    )
    parts = [
        f"# Results of `fploc reproduce --preset {preset}`\n\nRevision {revisions}. {notice}",
        "Metres. `rmse_m`, `p50_m` and `p90_m` hold the last fix; `rmse_fixed_m` is over intervals with a fix "
        "of their own. The intervals of all recordings of a device count alike; ± is over seeds. `paper` is the "
        "published RMSE, zero-shot first, two-device table second; its labels and subset are not known to be "
        "ours. `seen` is memory: the robot retraces one line. `own` is a method that filters by itself.\n",
        *(
            f"\n`{site}` lies on the office floor: its walls were seen in training, so zero-shot says less there.\n"
            for site in SHARED_FLOOR
            if any(tracked.record.site == site for tracked in records)
        ),
    ]
    for labels in ("repaired", "published"):
        rows = comparison_rows(records, labels=labels)
        parts.append(f"\n## {labels.capitalize()} labels\n\n{markdown(rows)}")
    if not made_up:
        parts.append(f"\n## The paper's own numbers\n\n{markdown(_paper_rows())}")
    return "".join(parts)


def _row(
    protocol: str, site: str, device: int, method: str, filter_name: str, group: Sequence[Record]
) -> dict[str, str]:
    filtered = filter_name == "kalman"
    paper = (
        []
        if filter_name == "own"
        else published(protocol, method, site, device, filtered=filtered, metric="rmse_m")
    )
    return {
        "protocol": protocol,
        "site": site,
        "device": str(device),
        "method": method,
        "filter": FILTERS[filter_name],
        **{metric: _mean_text([getattr(one, metric) for one in group]) for metric in METRICS},
        "no fix": _mean_text([one.no_fix_share for one in group]),
        "paper": ", ".join(row.value for row in paper) or UNKNOWN,
        "ms/fix": _mean_text([one.ms_per_fix for one in group]),
    }


def _mean_text(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return UNKNOWN
    if len(known) == 1:
        return f"{known[0]:.2f}"
    return f"{np.mean(known):.2f} ± {np.std(known, ddof=1):.2f}"


def _paper_rows() -> list[dict[str, str]]:
    return [
        {
            "experiment": row.experiment,
            "site": row.site,
            "device": "" if row.device is None else str(row.device),
            "method": row.method,
            "metric": row.metric,
            "value": row.value,
            "note": row.note,
        }
        for row in paper_numbers()
    ]
