"""docs/results.md: generated from the committed records and facts, and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from statistics import mean, stdev

from fploc.datasets.pages import markdown_grid
from fploc.evaluation import facts_sections as sections
from fploc.evaluation.conditions import is_studied
from fploc.evaluation.paper_comparison import comparison_sections, worse_sentences
from fploc.evaluation.protocols import SOURCE_FLOOR
from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.relative_figures import (
    OURS,
    device_gap_rows,
    gain_rows,
    link_rows,
    percent,
    tuning_rows,
)
from fploc.evaluation.report import REAL_PLAN, variant_of
from fploc.evaluation.selection import UNFILTERED, RecordBook, Slot
from fploc.evaluation.study_tables import study_sections
from fploc.evaluation.tables import MISSING, NOT_RUN, UNKNOWN, listed, signed

Rows = list[dict[str, str]]

BASE, PUBLISHED_WIDTHS = "full", "published"
MADE_UP_NOTICE = (
    "**Made-up buildings.** The public data could not be reached: nothing here says anything about the public sites "
    "or the paper."
)
HEADLINES = (
    ("shopping-mall", "1.19 m", 1.0),
    ("laboratory", "1.14 m, row not stated", 1.1),
)
"""Site, the paper's RMSE, and the goal that was set before the trainings, metres."""

Cell = Callable[[Slot], str]


def results_page(records: Sequence[TrackedRecord], facts: sections.Facts, *, preset: str = BASE) -> str:
    """Return the page as Markdown; what was not run is said to be so.

    Args:
        records: Of ``preset``, its variants, and of the preset ``published``.
        facts: See ``facts_sections``.
        preset: The one that the tables are of.
    """
    book = RecordBook(records, preset)
    made_up = any(one.made_up for one in records)
    beside_paper = {
        "Headline": _headline(book),
        "The paper's numbers, one by one": comparison_sections(book),
        "Where ours is worse than the paper": _worse(book, facts),
        "Relative figures": _relative(book),
    }
    titled = {
        "How to read this page": MADE_UP_NOTICE if made_up else _how_to_read(book, facts, preset),
        **({} if made_up else beside_paper),
        "How sure the differences are": sections.certainty(facts),
        "All methods": _comparison(book),
        **study_sections(book),
        "Stage by stage": sections.stages(facts),
        "What the plan is worth": _plans(book),
        "Ablations": _ablations(book, facts),
        "What plan, survey, phone and parts are worth to the default": sections.parts(facts),
        "Offline": sections.offline(facts),
        "Generated and measured data": sections.generator(facts),
        "Published widths": _published_widths(records),
        "Complexity": sections.complexity(book, facts),
        "Time of a fix": sections.timings(facts),
        "The server under load": sections.load(facts),
        "Cost of training": sections.training(facts),
    }
    body = "".join(f"\n## {title}\n\n{text.strip()}\n" for title, text in titled.items())
    return f"# Results\n{body}"


def _how_to_read(book: RecordBook, facts: sections.Facts, preset: str) -> str:
    scored = listed(one.commit for one in book.records)
    trained = listed(row.get("commit") for row in facts.get("training_cost", ()))
    seeds = sorted({one.seed for one in book.records})
    floor = ", ".join(f"`{site}`" for site in SOURCE_FLOOR)
    return f"""Generated from `results.jsonl` and `results-facts.json`, written by `fploc reproduce --preset {preset}`
(seeds {", ".join(map(str, seeds)) or UNKNOWN}).
Trained at revision {trained}; scored at revision {scored}.

- **Development sites.** Methods were chosen looking at all sites on this page: none of them is a clean test.
- **Labels.** Repaired labels used RTT in part and favour methods that trust it; published ones are wrong by metres
  in places. Neither alone is the truth, so both are given, and a ranking should hold under both. Those of
  `office-position1` and `office-position2` are reconstructed (1σ about 0.45 m): nothing is ranked by them.
- **The paper.** Its labels, its choice of recordings and intervals, and which device it means are not known to be
  ours. Where ours is smaller this does not say that ours is better; each table says what differs.
- **`seen` is memory.** The robot retraces one line, so that a method can learn the office by heart.
- {floor} lie on the office's floor: their walls were seen in training, and zero-shot says less there.
- **Scores.** Metres; the last fix is held where an interval has none; the intervals of all recordings of a device
  count alike; causal, with one speed prior of 0.5 m/s. `KF`: Kalman filter; methods that filter by themselves stand
  in the same tables with their own filter and no other behind it. ± is the standard deviation over seeds; a number
  without it has one seed or needs no training.
- **Thinned.** The robot moves at 0.05 to 0.1 m/s. Keeping every tenth interval with the original time step makes it
  ten times as fast, which is nearer to a person and harder for every filter."""


def _headline(book: RecordBook) -> str:
    rows = []
    for site, paper, goal_m in HEADLINES:
        slot = Slot("zero-shot", site, 1, OURS)
        own = book.mean(slot)
        rows.append(
            {
                "site": site,
                "ours, repaired labels": book.text(slot),
                "ours, published labels": book.text(replace(slot, labels="published")),
                "paper": paper,
                "goal, repaired labels": f"{goal_m:.2f} m",
                "goal met": NOT_RUN if own is None else ("yes" if own <= goal_m else "no"),
            }
        )
    return f"RMSE of `{OURS}` with KF, zero-shot from the office, device 1, metres.\n\n{markdown_grid(rows)}"


def _worse(book: RecordBook, facts: sections.Facts) -> str:
    sentences = worse_sentences(book, facts.get("chain_stages", ()))
    if not book.records:
        return NOT_RUN
    if not sentences:
        return "Nowhere, of what was run and can be ranked."
    return (
        "By repaired labels, generated from the numbers. Rows on reconstructed labels are not ranked.\n\n"
        + "".join(f"- {sentence}\n" for sentence in sentences)
    )


def _relative(book: RecordBook) -> str:
    parts = []
    for labels in ("repaired", "published"):
        tables = {
            f"RMSE of zero-shot `{OURS}` with KF against each method's: above 0 ours is smaller": gain_rows(
                book, labels
            ),
            "Fine-tuning, on the same second part of each path": tuning_rows(book, labels),
            "Device 2, which hears two access points, against device 1": device_gap_rows(book, labels),
            "The link between the devices, on the same intervals": link_rows(book, labels),
        }
        parts += [
            f"### {title} ({labels} labels)\n\n{markdown_grid(rows) or MISSING}\n"
            for title, rows in tables.items()
        ]
    return "".join(parts)


def _comparison(book: RecordBook) -> str:
    parts = []
    thins = sorted({one.thin for one in book.records if not variant_of(one.preset)})
    for protocol in dict.fromkeys(one.protocol for one in book.records):
        views = {
            "with KF, repaired labels, RMSE": (Slot(protocol, "", 0, ""), book.text),
            "with KF, repaired labels, median and 90 %": (Slot(protocol, "", 0, ""), _quantiles(book)),
            "with KF, published labels, RMSE": (Slot(protocol, "", 0, "", labels="published"), book.text),
            "unfiltered, repaired labels, RMSE": (Slot(protocol, "", 0, "", filters=UNFILTERED), book.text),
        }
        views |= {
            f"with KF, repaired labels, RMSE, every {thin}th interval": (
                Slot(protocol, "", 0, "", thin=thin), book.text,
            )
            for thin in thins[1:]
        }  # fmt: skip
        for title, (like, cell) in views.items():
            table = markdown_grid(_pivot(book, like, cell))
            if table:
                parts.append(f"### {protocol}: {title}\n\n{table}\n")
    return "".join(parts) or NOT_RUN


def _plans(book: RecordBook) -> str:
    plans = [REAL_PLAN, *dict.fromkeys(one.plan for one in book.records if one.plan != REAL_PLAN)]
    like = Slot("zero-shot", "", 0, "")
    places = [
        slot
        for slot in book.slots(like)
        if slot.method == OURS and any(book.find(replace(slot, plan=plan)) for plan in plans[1:])
    ]
    rows = [
        {
            "plan": plan,
            **{_place(slot): _against(book, replace(slot, plan=plan), slot) for slot in places},
        }
        for plan in plans
        if places
    ]
    return (
        f"RMSE of zero-shot `{OURS}` with KF, repaired labels; in brackets the change against the real plan, of the "
        "same trained networks. `blank`: a crop with nothing drawn; `length`: the crop's length alone; `none`: "
        "neither; a site's name: that site's plan instead.\n\n"
        f"{markdown_grid(rows) or MISSING}"
    )


def _ablations(book: RecordBook, facts: sections.Facts) -> str:
    reasons: Mapping[str, str] = facts.get("ablations", {})
    found = dict.fromkeys(variant for one in book.records if (variant := variant_of(one.preset)))
    names = list(dict.fromkeys([*reasons, *found]))
    like = Slot("zero-shot", "", 0, "")
    places = [
        slot
        for slot in book.slots(like)
        if slot.method == OURS and any(book.find(replace(slot, variant=name)) for name in names)
    ]
    base = {
        "ablation": "none",
        "seeds": _seeds(book, places),
        **{_place(slot): book.text(slot) for slot in places},
        "why": "the preset as it is",
    }
    rows = [base] * bool(places) + [
        {
            "ablation": name,
            "seeds": _seeds(book, [replace(slot, variant=name) for slot in places]),
            **{_place(slot): _paired_difference(book, replace(slot, variant=name), slot) for slot in places},
            "why": reasons.get(name, UNKNOWN),
        }
        for name in names
    ]
    missing = [name for name in names if name not in found]
    text = (
        f"RMSE of zero-shot `{OURS}` with KF, repaired labels. The first row is absolute; the others are the "
        "difference to it over the seeds that both have: above 0 the change makes it worse.\n\n"
    )
    not_run = f"\nNot run: {', '.join(missing)}.\n" if missing and found else ""
    return f"{text}{markdown_grid(rows) if found else MISSING}{not_run}"


def _published_widths(records: Sequence[TrackedRecord]) -> str:
    book = RecordBook(records, PUBLISHED_WIDTHS)
    rows = []
    for protocol in dict.fromkeys(one.protocol for one in book.records):
        for slot in book.slots(Slot(protocol, "", 0, "")):
            rows.append(
                {
                    "protocol": protocol,
                    "site": slot.site,
                    "device": str(slot.device),
                    "method": slot.method,
                    "unfiltered [m]": book.text(replace(slot, filters=UNFILTERED)),
                    "with KF [m]": book.text(slot),
                    "with KF, published labels [m]": book.text(replace(slot, labels="published")),
                    "ms a fix, in a batch": book.text(replace(slot, filters=UNFILTERED), "ms_per_fix"),
                }
            )
    thinned = (
        f", every {book.thin}th interval (a robot {book.thin} times as fast, which the filter cannot follow)"
        if book.thin > 1
        else ""
    )
    return (
        f"Networks of the published widths, trained once on the office, one seed{thinned}; RMSE, repaired labels "
        f"unless said. What the training cost stands in the last table.\n\n{markdown_grid(rows) or MISSING}"
    )


def _pivot(book: RecordBook, like: Slot, cell: Cell) -> Rows:
    """Return methods, and conditions where there are any, by places."""
    conditions = dict.fromkeys(
        one.condition
        for one in book.records
        if one.protocol == like.protocol and not is_studied(one.condition)
    )
    slots = [slot for condition in conditions for slot in book.slots(replace(like, condition=condition))]
    places = sorted({(slot.site, slot.device) for slot in slots})
    with_conditions = any(slot.condition for slot in slots)
    return [
        {
            "method": method,
            **({"condition": condition or UNKNOWN} if with_conditions else {}),
            **{
                f"{site} {device}": cell(
                    replace(like, site=site, device=device, method=method, condition=condition)
                )
                for site, device in places
            },
        }
        for method, condition in dict.fromkeys((slot.method, slot.condition) for slot in slots)
    ]


def _quantiles(book: RecordBook) -> Cell:
    def cell(slot: Slot) -> str:
        median, ninety = book.mean(slot, "p50_m"), book.mean(slot, "p90_m")
        return UNKNOWN if median is None or ninety is None else f"{median:.2f}, {ninety:.2f}"

    return cell


def _place(slot: Slot) -> str:
    return f"{slot.site} {slot.device}"


def _against(book: RecordBook, slot: Slot, base: Slot) -> str:
    """Return an RMSE and, in brackets, its change against another's."""
    own, other = book.mean(slot), book.mean(base)
    if slot == base or own is None or other is None:
        return book.text(slot)
    return f"{book.text(slot)} ({percent(own / other - 1.0)})"


def _paired_difference(book: RecordBook, slot: Slot, base: Slot) -> str:
    """Return the difference in RMSE over the seeds that both have."""
    before = {one.seed: one.rmse_m for one in book.find(base) if one.rmse_m is not None}
    differences = [
        one.rmse_m - before[one.seed]
        for one in book.find(slot)
        if one.rmse_m is not None and one.seed in before
    ]
    if not differences:
        return UNKNOWN
    spread = f" ± {stdev(differences):.2f}" if len(differences) > 1 else ""
    return f"{signed(mean(differences))}{spread}"


def _seeds(book: RecordBook, slots: Sequence[Slot]) -> str:
    return str(max((len(book.find(slot)) for slot in slots), default=0))
