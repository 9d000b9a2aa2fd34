"""Every number of the paper, ours beside it or the reason why there is none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.paper_numbers import KALMAN_SUFFIX, MOVED_SITES, PaperNumber, paper_numbers
from fploc.evaluation.relative_figures import BEFORE_TUNING, OURS, TWO_ACCESS_POINTS
from fploc.evaluation.selection import FILTERED, UNFILTERED, RecordBook, Slot
from fploc.evaluation.tables import NOT_RUN, UNKNOWN

COST = "cost"
KINDS_OF_LABELS = ("repaired", "published")
BOUND = ">"
NETWORKS = ("gnn", "fpdnn")


@dataclass(frozen=True)
class Counterpart:
    """Where an experiment of the paper has its like here.

    Args:
        protocol: Of ours.
        differs: What is known to differ, one sentence.
        ranked: False where our labels do not allow to say which is smaller.
    """

    protocol: str
    differs: str
    ranked: bool = True


COUNTERPARTS = {
    "seen": Counterpart(
        "seen",
        "The paper trains on four laps; here laps 1, 2 and 4 train, lap 3 (three quarters of a lap) validates. "
        "Lap 5 is tested in both. The robot retraces one line: this is memory.",
    ),
    "zero-shot, APs moved": Counterpart(
        "ap-moved",
        "The paper does not say which of the two layouts it means. The labels that it used are not in the files "
        "at hand: those here are reconstructed (1σ about 0.45 m), so that nothing is ranked by them.",
        ranked=False,
    ),
    "fine-tuned, APs moved": Counterpart(
        "fine-tuned",
        "As above; left part to learn from, right part to test on, as in the paper, but the line between "
        "them is ours.",
        ranked=False,
    ),
    "zero-shot": Counterpart(
        "zero-shot",
        "The paper does not say which laps, which of the two devices and which labels it tests on: ours are all "
        "laps of one device. Its values with and without filter are swapped in the text and set right here.",
    ),
    "fine-tuned": Counterpart(
        "fine-tuned",
        "The paper's parts to learn from and to test on are not stated for these sites: ours are the two halves of "
        "each path with a gap of 1 m between them.",
    ),
    "not stated": Counterpart(
        "zero-shot",
        "From the paper's list of contributions, which does not say of what: ours is zero-shot.",
    ),
    "two devices": Counterpart(
        "multi-device",
        "The paper does not say which intervals, nor which two access points device 2 hears: ours are the "
        "intervals with a link between the devices, and for device 2 the mean over all pairs of access "
        "points that it hears (best and worst pair in brackets). `trilateration` there has no stated "
        "variant, so its numbers are beside ours but nothing is reproduced by them.",
    ),
}
FILTER_NOT_STATED = {("fine-tuned", "laboratory"), ("not stated", "laboratory")}


def comparison_sections(book: RecordBook) -> str:
    """Return a table for each experiment of the paper, with what differs above it."""
    parts = []
    for experiment, counterpart in COUNTERPARTS.items():
        rows = [row for row in _numbers() if row.experiment == experiment]
        table = markdown_grid([_row(book, row, counterpart) for row in rows])
        parts.append(f"\n### {experiment}\n\n{counterpart.differs}\n\n{table}")
    return "".join(parts)


def cost_rows(book: RecordBook, complexity: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Return the paper's numbers on cost with ours beside them.

    Args:
        book: Records, whose time for a fix stands for rivals.
        complexity: Rows of ``fploc.evaluation.complexity``.
    """
    by_name = {row["network"]: row for row in complexity}
    keys = {"parameters": "parameters", "flops": "flops", "ms_per_sample": "ms"}
    rows = []
    for number in paper_numbers():
        if number.experiment != COST:
            continue
        network = number.method in NETWORKS
        rows.append(
            {
                "method": number.method,
                "metric": number.metric,
                "paper": number.value,
                **{
                    f"ours, {widths}": _count(by_name.get(name, {}).get(keys[number.metric]))
                    if network
                    else UNKNOWN
                    for widths, name in (
                        ("published widths", f"{number.method}-paper"),
                        ("small", number.method),
                    )
                },
                "ours, a rival's fix in a batch": UNKNOWN if network else _ms(book, number.method),
                "note": number.note,
            }
        )
    return rows


def worse_sentences(book: RecordBook, stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each method and place where ours is above the paper's number, and what bears on it.

    Args:
        book: The records.
        stages: Rows of ``chain_stages`` with their protocol, site and device.
    """
    sentences = []
    rows = [
        row for row in _numbers() if COUNTERPARTS[row.experiment].ranked and not row.value.startswith(BOUND)
    ]
    for (experiment, site, device, method), group in groupby(
        rows, key=lambda row: (row.experiment, row.site, row.device, row.method)
    ):
        counterpart = COUNTERPARTS[experiment]
        above = [text for row in group if (text := _above(book, row, counterpart))]
        if above:
            slot = _slot(counterpart, site, device, method)
            reason = _bearing(book, slot, stages)
            sentences.append(f"{experiment}, {site}, device {device}, {method}: {'; '.join(above)}. {reason}")
    return sentences


def _numbers() -> list[PaperNumber]:
    return [row for row in paper_numbers() if row.experiment != COST]


def _row(book: RecordBook, row: PaperNumber, counterpart: Counterpart) -> dict[str, str]:
    ours = {labels: _ours(book, row, counterpart, labels) for labels in KINDS_OF_LABELS}
    if ours["published"] == NOT_RUN and ours["repaired"] != NOT_RUN:
        ours["published"] = "no published labels there"
    return {
        "site": row.site,
        "device": str(row.device),
        "method": row.method,
        "metric": row.metric,
        "paper": row.value,
        **{f"ours, {labels} labels": text for labels, text in ours.items()},
        "note": row.note,
    }


def _ours(book: RecordBook, row: PaperNumber, counterpart: Counterpart, labels: str) -> str:
    """Return our number or numbers: of several methods, layouts or filters, each with its name."""
    methods = row.method.split(" / ")
    sites = [ours for ours, theirs in MOVED_SITES.items() if theirs == row.site]
    if "moved" not in row.experiment.lower():
        sites = [row.site]
    texts = []
    for method in methods:
        for site in sites:
            for filters, name in _filters(row):
                slot = replace(_slot(counterpart, site, row.device, method), labels=labels)
                slot = slot if filters is None else replace(slot, filters=filters)
                text = _text(book, slot, row.metric)
                labelled = [method] * (len(methods) > 1) + [site] * (len(sites) > 1) + [name] * bool(name)
                if text != UNKNOWN:
                    texts.append(" ".join([*labelled, text]))
    return "; ".join(texts) or NOT_RUN


def _filters(row: PaperNumber) -> list[tuple[tuple[str, ...] | None, str]]:
    if (row.experiment, row.site) in FILTER_NOT_STATED:
        return [(UNFILTERED, "unfiltered"), (FILTERED, "with KF")]
    return [(None, "")]


def _slot(counterpart: Counterpart, site: str, device: int | None, method: str) -> Slot:
    assert device is not None, "every number but those on cost is of a device"
    filtered = method.endswith(KALMAN_SUFFIX)
    pairs = counterpart.protocol == "multi-device" and device == 2
    return Slot(
        protocol=counterpart.protocol,
        site=site,
        device=device,
        method=method.removesuffix(KALMAN_SUFFIX),
        filters=FILTERED if filtered else UNFILTERED,
        condition=TWO_ACCESS_POINTS if pairs else "",
    )


def _text(book: RecordBook, slot: Slot, metric: str) -> str:
    """Return a number; of device 2 with two access points, the best and the worst pair in brackets."""
    text = book.text(slot, metric)
    if slot.condition != TWO_ACCESS_POINTS or text == UNKNOWN:
        return text
    best, worst = (
        book.text(replace(slot, condition=f"two APs, {which}"), metric) for which in ("best", "worst")
    )
    return f"{text} ({best} to {worst})"


def _above(book: RecordBook, row: PaperNumber, counterpart: Counterpart) -> str:
    """Return our value of a metric beside the paper's where ours is the greater one, else nothing."""
    slot = _slot(counterpart, row.site, row.device, row.method)
    repaired, theirs = book.mean(slot, row.metric), float(row.value)
    if repaired is None or repaired <= theirs:
        return ""
    other = book.mean(replace(slot, labels="published"), row.metric)
    also = "" if other is None else f" (published labels {other:.2f} m)"
    name = row.metric.removesuffix("_m").upper()
    return f"{name} {repaired:.2f} m{also} for {row.value} m, {100 * (repaired / theirs - 1):.0f} % more"


def _bearing(book: RecordBook, slot: Slot, stages: Sequence[Mapping[str, Any]]) -> str:
    """Return the experiments that say where the error comes from, with their numbers."""
    found = [*_stage_texts(slot, stages), *_condition_texts(book, slot), *_plan_texts(book, slot)]
    return f"What bears on it: {'; '.join(found)}." if found else "No experiment here bears on it yet."


def _stage_texts(slot: Slot, stages: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    protocol = "zero-shot" if slot.protocol in ("multi-device", "fine-tuned") else slot.protocol
    there = [
        row
        for row in stages
        if (row["protocol"], row["site"], row["device"]) == (protocol, slot.site, slot.device)
    ]
    if not there or slot.method not in ("gnn", OURS):
        return
    row = there[0]
    alone = " of a device alone" if slot.protocol == "multi-device" else ""
    yield (
        f"stage table{alone}: ranges are off by {_metres(row['range_raw_mae_m'])} before FPDNN and "
        f"{_metres(row['range_fpdnn_mae_m'])} after it, positions by {_metres(row['GNN'])} (GNN), "
        f"{_metres(row['GNN + KF'])} (with KF), {_metres(row['GNN + FPDNN'])} (solved) and "
        f"{_metres(row['GNN + FPDNN + KF'])} (with KF)"
    )


def _condition_texts(book: RecordBook, slot: Slot) -> Iterator[str]:
    conditions = {
        "multi-device": ("without link", "two APs, best", "two APs, worst", "all intervals"),
        "fine-tuned": (BEFORE_TUNING,),
    }
    for condition in conditions.get(slot.protocol, ()):
        mean = book.mean(replace(slot, condition=condition))
        if mean is not None:
            yield f"RMSE {condition} {_metres(mean)}"


def _plan_texts(book: RecordBook, slot: Slot) -> Iterator[str]:
    if slot.protocol != "zero-shot" or slot.method != OURS:
        return
    plans = dict.fromkeys(one.plan for one in book.records if one.plan != slot.plan)
    texts = [
        f"{plan} {_metres(mean)}"
        for plan in plans
        if (mean := book.mean(replace(slot, plan=plan))) is not None
    ]
    real = book.mean(slot)
    if texts and real is not None:
        yield f"RMSE by plan: real {_metres(real)}, {', '.join(texts)}"


def _ms(book: RecordBook, method: str) -> str:
    slot = Slot("zero-shot", "shopping-mall", 1, method, filters=UNFILTERED)
    return book.text(slot, "ms_per_fix") if book.find(slot) else NOT_RUN


def _count(value: float | None) -> str:
    if value is None:
        return NOT_RUN
    return f"{value:,}" if isinstance(value, int) else f"{value:.2f}"


def _metres(value: float | None) -> str:
    return "an unknown length" if value is None else f"{value:.2f} m"
