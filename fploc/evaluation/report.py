"""Tables of result records, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fploc.evaluation.paper_numbers import paper_numbers, published
from fploc.evaluation.records import Record

METRICS = ("rmse_m", "rmse_fixed_m", "p50_m", "p90_m")
UNKNOWN = "–"


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


def page(records: Sequence[TrackedRecord], *, preset: str, commit: str | None) -> str:
    """Return the results of one preset as a Markdown page."""
    made_up = any(tracked.made_up for tracked in records)
    notice = (
        "**Made-up buildings.** The public data could not be reached: nothing here says anything about "
        "the public sites or the paper.\n\n"
        if made_up
        else "The local sites are development sites: methods were chosen looking at them. "
        "Repaired labels used RTT in part and favour methods that trust it; both kinds stand below.\n\n"
    )
    parts = [
        f"# Results of `fploc reproduce --preset {preset}`\n\nRevision {commit or 'unknown'}. {notice}",
        "Metres. `rmse_m`, `p50_m` and `p90_m` hold the last fix; `rmse_fixed_m` is over intervals with a fix "
        "of their own; means over recordings and seeds. `paper` is the published RMSE, zero-shot first, "
        "two-device table second; its labels and subset are not known to be ours.\n",
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
    paper = published(method, site, device, filtered=filtered, metric="rmse_m")
    return {
        "protocol": protocol,
        "site": site,
        "device": str(device),
        "method": method,
        "filter": "KF" if filtered else "none",
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
