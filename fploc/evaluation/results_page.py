"""docs/results.md: generated from the committed records and facts, and from nothing else.

Facts are what records cannot hold, as plain JSON values; every key may be missing:

- ``complexity``: rows of ``fploc.evaluation.complexity.complexity_rows``;
- ``generator_match``: contents of ``match.json`` of each site (``fploc synthesize``);
- ``chain_stages``: ``fploc.evaluation.chain_stages.chain_stages`` with ``protocol``, ``site`` and ``device``;
- ``differences``, ``against_best`` and ``recordings``: rows of ``fploc.evaluation.certainty`` with ``protocol``
  and ``site``;
- ``timings``: rows of ``fploc bench``;
- ``offline``: records of ``fploc evaluate --smoother``, as JSON;
- ``plan_worth``: rows of benchmarks/plan_worth.py;
- ``load_curve``: rows of ``curve`` in docs/load.json (``make soak``);
- ``training_cost``: rows of ``stage``, ``seconds`` and, where known, ``links``, ``preset`` and ``commit``;
- ``virtual_rates``: links per second by name of the networks;
- ``ablations``: why each was made, by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import mean, stdev
from typing import Any

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.chain_stages import STAGES
from fploc.evaluation.conditions import is_studied
from fploc.evaluation.generator_match import printed_rows
from fploc.evaluation.paper_comparison import NOT_RUN, comparison_sections, cost_rows, worse_sentences
from fploc.evaluation.records import OWN, TrackedRecord
from fploc.evaluation.relative_figures import (
    OURS,
    device_gap_rows,
    gain_rows,
    link_rows,
    percent,
    tuning_rows,
)
from fploc.evaluation.report import REAL_PLAN, SHARED_FLOOR, variant_of
from fploc.evaluation.selection import UNFILTERED, RecordBook, Slot
from fploc.evaluation.study_tables import study_sections
from fploc.evaluation.tables import UNKNOWN, mean_text

Facts = Mapping[str, Any]
Rows = list[dict[str, str]]

BASE, PUBLISHED_WIDTHS = "full", "published"
SHOWN_PROTOCOL = "zero-shot"
"""Of the tables on certainty."""
MADE_UP_NOTICE = (
    "**Made-up buildings.** The public data could not be reached: nothing here says anything about the public sites "
    "or the paper."
)
HEADLINES = (
    ("shopping-mall", "1.19 m", 1.0),
    ("laboratory", "1.14 m, row not stated", 1.1),
)
"""Site, the paper's RMSE, and the goal that was set before the trainings, metres."""

IN_TIME = 0.99
"""Share of fixes that must be out by the deadline."""

Cell = Callable[[Slot], str]


def results_page(records: Sequence[TrackedRecord], facts: Facts, *, preset: str = BASE) -> str:
    """Return the page as Markdown; what was not run is said to be so.

    Args:
        records: Of ``preset``, its variants, and of the preset ``published``.
        facts: See above.
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
    sections = {
        "How to read this page": MADE_UP_NOTICE if made_up else _how_to_read(book, facts, preset),
        **({} if made_up else beside_paper),
        "How sure the differences are": _certainty(facts),
        "All methods": _comparison(book),
        **study_sections(book),
        "Stage by stage": _stages(facts),
        "What the plan is worth": _plans(book),
        "Ablations": _ablations(book, facts),
        "What plan, survey and parts are worth to the default": _parts(facts),
        "Offline": _offline(facts),
        "Generated and measured data": _generator(facts),
        "Published widths": _published_widths(records),
        "Complexity": _complexity(book, facts),
        "Time of a fix": _timings(facts),
        "The server under load": _load(facts),
        "Cost of training": _training(facts),
    }
    body = "".join(f"\n## {title}\n\n{text.strip()}\n" for title, text in sections.items())
    return f"# Results\n{body}"


def _how_to_read(book: RecordBook, facts: Facts, preset: str) -> str:
    scored = _listed(one.commit for one in book.records)
    trained = _listed(row.get("commit") for row in facts.get("training_cost", ()))
    seeds = sorted({one.seed for one in book.records})
    floor = ", ".join(f"`{site}`" for site in SHARED_FLOOR)
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


def _worse(book: RecordBook, facts: Facts) -> str:
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
            f"### {title} ({labels} labels)\n\n{markdown_grid(rows) or _not_run()}\n"
            for title, rows in tables.items()
        ]
    return "".join(parts)


def _certainty(facts: Facts) -> str:
    recordings = [
        {
            "site": row["site"],
            "device": str(row["device"]),
            "method": row["method"],
            "recordings": str(row["recordings"]),
            "mean RMSE [m]": _plain(row["rmse_m"]),
            "weighted by arc length [m]": _plain(row["rmse_by_arc_m"]),
            "best and worst [m]": f"{_plain(row['low_m'])} to {_plain(row['high_m'])}",
        }
        for row in facts.get("recordings", ())
        if row["protocol"] == SHOWN_PROTOCOL
    ]
    return (
        f"{SHOWN_PROTOCOL.capitalize()}, first seed, with filter, repaired labels; other protocols stand in "
        "`results-facts.json`. Blocks of 30 s are resampled: errors that follow one another are alike.\n\n"
        f"### Against `{OURS}`\n\n{markdown_grid(_differences(facts, 'differences')) or _not_run()}\n"
        "### Against the best at each place\n\nThe best is picked after the fact. The last columns are of the "
        "intervals in which both methods have a fix of their own.\n\n"
        f"{markdown_grid(_differences(facts, 'against_best')) or _not_run()}\n"
        "### Recordings\n\nRMSE of each recording by itself, then the mean.\n\n"
        f"{markdown_grid(recordings) or _not_run()}"
    )


def _differences(facts: Facts, name: str) -> Rows:
    return [
        {
            "site": row["site"],
            "device": str(row["device"]),
            "method": row["method"],
            "against": row["base"],
            "difference in RMSE [m]": _signed(row["rmse_m"]),
            "95 % of resamples [m]": f"{_signed(row['low_m'])} to {_signed(row['high_m'])}",
            "recordings in which it is worse": f"{row['recordings_below']} of {row['recordings']}",
            "both with a fix": UNKNOWN
            if row["common_share"] is None
            else f"{100 * row['common_share']:.0f} %",
            "RMSE there [m]": f"{_plain(row['common_m'])}, {_plain(row['common_base_m'])}",
        }
        for row in facts.get(name, ())
        if row["protocol"] == SHOWN_PROTOCOL
    ]


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


def _stages(facts: Facts) -> str:
    groups: dict[tuple[str, str, int], list[Mapping[str, Any]]] = {}
    for row in facts.get("chain_stages", ()):
        groups.setdefault((row["protocol"], row["site"], row["device"]), []).append(row)
    columns = {
        "range MAE, calibrated [m]": "range_raw_mae_m",
        "range MAE, FPDNN [m]": "range_fpdnn_mae_m",
        **{f"{stage} [m]": stage for stage in STAGES},
    }
    rows = [
        {
            "protocol": protocol,
            "site": site,
            "device": str(device),
            **{title: mean_text([row[name] for row in group]) for title, name in columns.items()},
        }
        for (protocol, site, device), group in groups.items()
    ]
    return (
        f"What each part of `{OURS}` does, repaired labels: how far ranges are off before and after FPDNN, on the "
        "same links, and the RMSE of positions after the GNN, its filter, the solver and the last filter.\n\n"
        f"{markdown_grid(rows) or _not_run()}"
    )


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
        f"{markdown_grid(rows) or _not_run()}"
    )


def _ablations(book: RecordBook, facts: Facts) -> str:
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
    return f"{text}{markdown_grid(rows) if found else _not_run()}{not_run}"


def _parts(facts: Facts) -> str:
    rows = facts.get("plan_worth", ())
    cells = {(row["what"], row["changed"], row["site"]): _both_devices(row) for row in rows}
    sites = dict.fromkeys(row["site"] for row in rows)
    table = [
        {
            "what": what,
            "changed": changed,
            **{site: cells.get((what, changed, site), UNKNOWN) for site in sites},
        }
        for what, changed in dict.fromkeys((row["what"], row["changed"]) for row in rows)
    ]
    return (
        "RMSE of `default` as it ships for zero-shot, device 1 / 2, m, own filter, repaired labels, every tenth "
        "interval at its own time (benchmarks/plan_worth.py). Plans are moved, scaled and turned under the access "
        "points, access points are moved under the plan; parts are taken away without training again.\n\n"
        + (markdown_grid(table) or _not_run())
    )


def _both_devices(row: Mapping[str, str]) -> str:
    return "/".join(row[f"device {device}, RMSE [m]"] for device in (1, 2))


def _offline(facts: Facts) -> str:
    rows = [
        {
            "site": record["site"],
            "device": str(record["device"]),
            "RMSE [m]": _plain(record["rmse_m"]),
            "90 % [m]": _plain(record["p90_m"]),
            "in the stated 95 % region": f"{100 * record['coverage95']:.0f} %",
            "NEES": _plain(record["nees"]),
        }
        for record in facts.get("offline", ())
        if record["filter"] == OWN
    ]
    return (
        "`default` for zero-shot with every recording known to its end (`--smoother`), its own smoother, repaired "
        "labels, every interval. Nothing else on this page looks ahead.\n\n"
        + (markdown_grid(rows) or _not_run())
    )


def _generator(facts: Facts) -> str:
    parts = []
    for match in facts.get("generator_match", ()):
        rows = printed_rows(match)
        table = markdown_grid(rows) or "No recording with positions to compare with.\n"
        parts.append(f"### {match['site']}: {match['kind']}\n\n{table}\n")
    rates = [
        {"networks": name, "virtual links a second": f"{rate:,.0f}"}
        for name, rate in facts.get("virtual_rates", {}).items()
    ]
    return (
        "How measured readings are distributed, beside samples of the generator for the same links and beside a "
        "generator that gives means only, as the paper's does.\n\n"
        + ("".join(parts) or f"{_not_run()}\n")
        + f"### Speed\n\n{markdown_grid(rates) or _not_run()}"
    )


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
        f"unless said. What the training cost stands in the last table.\n\n{markdown_grid(rows) or _not_run()}"
    )


def _complexity(book: RecordBook, facts: Facts) -> str:
    rows = [
        {
            "network": row["network"],
            "parameters": f"{row['parameters']:,}",
            "FLOPs": f"{row['flops']:,}",
            "ms": f"{row['ms']:.2f}",
            "paper's parameters": _thousands(row["paper_parameters"]),
            "paper's FLOPs": _thousands(row["paper_flops"]),
        }
        for row in facts.get("complexity", ())
    ]
    return (
        "One fix: a device that hears eight access points at 10 m. FLOPs by torch's own counter (matrix products), "
        "milliseconds as median of 50 runs on one thread, without the crops. Names ending in `-paper` have the "
        "published widths. **The counts differ from the paper's**: its table of widths cannot be built to the "
        "letter, and no layout was found that gives its parameters; its FLOPs of the GNN fit those widths with one "
        "layer and an update of all nine nodes, where only the device is updated here; one sample of its FPDNN "
        "may be one link, ours is eight.\n\n"
        f"{markdown_grid(rows) or _not_run()}\n### Beside the paper\n\n"
        "The paper's milliseconds are of an RTX 3090 (networks) and of an i9-12900KF (rivals).\n\n"
        f"{markdown_grid(cost_rows(book, facts.get('complexity', ())))}"
    )


def _timings(facts: Facts) -> str:
    rows = [
        {
            "method": row["method"],
            "threads": str(row["threads"]),
            "devices at once": str(row["batch"]),
            "median [ms]": f"{row['median_ms']:.3f}",
            "90 % [ms]": f"{row['p90_ms']:.3f}",
        }
        for row in facts.get("timings", ())
    ]
    return (
        "Of one device, by `fploc bench`, all methods in one run on this machine, at least 1,000 fixes each; of "
        "several devices at once, each one's share. Methods without the filter behind them, which has rows of its "
        f"own.\n\n{markdown_grid(rows) or _not_run()}"
    )


def _load(facts: Facts) -> str:
    curve = facts.get("load_curve", ())
    rows = [
        {
            "method": row["method"],
            "phones": str(row["devices"]),
            "in time": f"{100 * row['within_200_ms']:.1f} %",
            "median [ms]": f"{row['latency_p50_ms']:.0f}",
            "99 % [ms]": f"{row['latency_p99_ms']:.0f}",
            "age, median [ms]": f"{row['age_p50_ms']:.0f}",
            "fairness": _optional(row.get("accepted_fairness")),
        }
        for row in curve
    ]
    in_time: dict[str, int] = {}
    for row in curve:
        most = row["devices"] if row["within_200_ms"] >= IN_TIME else 0
        in_time[row["method"]] = max(most, in_time.get(row["method"], 0))
    listed = _listed(f"{devices} with `{method}`" for method, devices in in_time.items())
    return (
        "Phones at 5 Hz with 8 access points and `fploc serve` on one machine, by `make soak`; what else was "
        "measured stands in [load.md](load.md). In time: a live connection has the fix within 200 ms of its tick. "
        "Fairness: Jain's index of what was taken in of each phone, 1 where all got the same. 99 % are in time up to "
        f"this many phones: {listed}.\n\n{markdown_grid(rows) or _not_run()}"
    )


def _optional(share: float | None) -> str:
    return UNKNOWN if share is None else f"{share:.3f}"


def _training(facts: Facts) -> str:
    rows = [
        {
            "preset": row.get("preset", UNKNOWN),
            "stage": row["stage"],
            "seconds": f"{row['seconds']:,.0f}",
            "links": _thousands(row.get("links")),
        }
        for row in facts.get("training_cost", ())
    ]
    return markdown_grid(rows) or _not_run()


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
    return f"{_signed(mean(differences))}{spread}"


def _seeds(book: RecordBook, slots: Sequence[Slot]) -> str:
    return str(max((len(book.find(slot)) for slot in slots), default=0))


def _signed(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:+.2f}".replace("-", "−")


def _plain(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.2f}"


def _thousands(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:,.0f}"


def _listed(commits: Iterable[str | None]) -> str:
    return ", ".join(sorted({commit or UNKNOWN for commit in commits})) or UNKNOWN


def _not_run() -> str:
    return f"{NOT_RUN.capitalize()}.\n"
