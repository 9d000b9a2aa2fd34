"""The paper's own results, as data (Yu et al., tables, figures and text; paper_numbers.tsv)."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib import resources

KALMAN_SUFFIX = "+kf"
EXPERIMENTS = {
    "seen": ("seen",),
    "zero-shot": ("zero-shot", "two devices"),
    "ap-moved": ("zero-shot, APs moved",),
    "fine-tuned": ("fine-tuned", "fine-tuned, APs moved"),
    "multi-device": ("two devices",),
}
"""The paper's experiments that a protocol of ours can be laid beside."""
MOVED_SITES = {"office-position1": "office", "office-position2": "office"}
"""Layouts of ours that the paper calls the office with its access points moved; it does not say which."""


@dataclass(frozen=True)
class PaperNumber:
    """One published figure.

    Args:
        experiment: As the paper groups it.
        site: Name of the site; empty where none is meant.
        device: 1 or 2; None where none is meant.
        method: Name of the method; ``+kf`` behind it means with the Kalman filter.
        metric: Name of the metric, as in result records.
        value: As published, a number or a bound such as ``>1.5``.
        note: What a reader should know.
    """

    experiment: str
    site: str
    device: int | None
    method: str
    metric: str
    value: str
    note: str


def paper_numbers() -> list[PaperNumber]:
    """Return every published figure, in the paper's order."""
    text = (resources.files("fploc.evaluation") / "paper_numbers.tsv").read_text(encoding="utf-8")
    return [
        PaperNumber(
            experiment=row["experiment"],
            site=row["site"] or "",
            device=int(row["device"]) if row["device"] else None,
            method=row["method"],
            metric=row["metric"],
            value=row["value"],
            note=row["note"] or "",
        )
        for row in csv.DictReader(text.splitlines(), delimiter="\t")
    ]


def published(
    protocol: str, method: str, site: str, device: int, *, filtered: bool, metric: str
) -> list[PaperNumber]:
    """Return what the paper says of a method under a protocol, in the order of ``EXPERIMENTS``."""
    name = f"{method}{KALMAN_SUFFIX}" if filtered else method
    place = MOVED_SITES.get(site, site)
    return [
        row
        for experiment in EXPERIMENTS.get(protocol, ())
        for row in paper_numbers()
        if (row.experiment, row.method, row.site, row.device, row.metric)
        == (experiment, name, place, device, metric)
    ]
