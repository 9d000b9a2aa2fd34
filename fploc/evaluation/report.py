"""Tables of result records, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.conditions import is_studied
from fploc.evaluation.paper_numbers import paper_numbers, published
from fploc.evaluation.protocols import SOURCE_FLOOR
from fploc.evaluation.records import KALMAN, NO_FILTER, OWN, Record, TrackedRecord
from fploc.evaluation.tables import UNKNOWN, mean_text

METRICS = ("rmse_m", "rmse_fixed_m", "p50_m", "p90_m")
REAL_PLAN = "real"
FILTERS = {NO_FILTER: "none", KALMAN: "KF", OWN: "own"}


def variant_of(preset: str) -> str:
    """Return what stands behind ``--`` in the name of a preset: its ablation; empty for the preset itself."""
    return preset.partition("--")[2]


def setting_of(record: Record) -> str:
    """Return what a record departs in from the plain evaluation of its preset; empty where in nothing."""
    parts = (
        variant_of(record.preset),
        "" if record.plan == REAL_PLAN else f"plan {record.plan}",
        "" if record.thin == 1 else f"thin {record.thin}",
        record.condition,
    )
    return "; ".join(part for part in parts if part)


def headline_records(records: Sequence[TrackedRecord]) -> list[TrackedRecord]:
    """Return the records without ablation, of the site's own plan and without condition, least thinned."""
    plain = [
        one
        for one in records
        if not (variant_of(one.record.preset) or one.record.condition) and one.record.plan == REAL_PLAN
    ]
    least = min((one.record.thin for one in plain), default=1)
    return [one for one in plain if one.record.thin == least]


def comparison_rows(records: Sequence[TrackedRecord], *, labels: str) -> list[dict[str, str]]:
    """Return methods × sites × devices × {unfiltered, KF}, means over seeds, the paper's RMSE beside.

    Args:
        records: Of one preset and its variants.
        labels: Kind of labels that the rows are scored with.
    """
    groups: dict[tuple[str, str, int, str, str, str], list[Record]] = {}
    for tracked in records:
        one = tracked.record
        if one.labels == labels:
            key = (one.protocol, one.site, one.device, one.method, one.filter, setting_of(one))
            groups.setdefault(key, []).append(one)
    return [_row(*key, group) for key, group in groups.items()]


def page(records: Sequence[TrackedRecord], *, preset: str) -> str:
    """Return the results of one preset as a Markdown page; its studies stand in their records alone."""
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
        "ours. `seen` is memory: the robot retraces one line. `own` is a method that filters by itself. "
        "`setting` is what differs from the plain evaluation: an ablation, another plan, every so many-th "
        "interval (`thin`), or a condition.\n",
        *(
            f"\n`{site}` lies on the office floor: its walls were seen in training, so zero-shot says less there.\n"
            for site in SOURCE_FLOOR
            if any(tracked.record.site == site for tracked in records)
        ),
    ]
    shown = [one for one in records if not is_studied(one.record.condition)]
    for labels in ("repaired", "published"):
        rows = comparison_rows(shown, labels=labels)
        parts.append(f"\n## {labels.capitalize()} labels\n\n{markdown_grid(rows)}")
    if not made_up:
        parts.append(f"\n## The paper's own numbers\n\n{markdown_grid(_paper_rows())}")
    return "".join(parts)


def _row(
    protocol: str,
    site: str,
    device: int,
    method: str,
    filter_name: str,
    setting: str,
    group: Sequence[Record],
) -> dict[str, str]:
    filtered = filter_name == KALMAN
    paper = (
        []
        if filter_name == OWN or setting
        else published(protocol, method, site, device, filtered=filtered, metric="rmse_m")
    )
    return {
        "protocol": protocol,
        "site": site,
        "device": str(device),
        "method": method,
        "filter": FILTERS[filter_name],
        "setting": setting or UNKNOWN,
        **{metric: mean_text([getattr(one, metric) for one in group]) for metric in METRICS},
        "no fix": mean_text([one.no_fix_share for one in group]),
        "paper": ", ".join(row.value for row in paper) or UNKNOWN,
        "ms/fix": mean_text([one.ms_per_fix for one in group]),
    }


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
