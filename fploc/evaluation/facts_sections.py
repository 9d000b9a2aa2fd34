"""Sections of the results page on what records cannot hold: facts, as plain JSON values.

Every key of the facts may be missing:

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

from collections.abc import Mapping
from typing import Any

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.chain_stages import STAGES
from fploc.evaluation.generator_match import printed_rows
from fploc.evaluation.paper_comparison import cost_rows
from fploc.evaluation.records import OWN
from fploc.evaluation.relative_figures import OURS
from fploc.evaluation.selection import RecordBook
from fploc.evaluation.tables import MISSING, UNKNOWN, listed, mean_text, plain, signed, thousands

Facts = Mapping[str, Any]

SHOWN_PROTOCOL = "zero-shot"
"""Of the tables on certainty."""

IN_TIME = 0.99
"""Share of fixes that must be out by the deadline."""


def certainty(facts: Facts) -> str:
    """Return bootstrapped differences between methods, and the recordings one by one."""
    recordings = [
        {
            "site": row["site"],
            "device": str(row["device"]),
            "method": row["method"],
            "recordings": str(row["recordings"]),
            "mean RMSE [m]": plain(row["rmse_m"]),
            "weighted by arc length [m]": plain(row["rmse_by_arc_m"]),
            "best and worst [m]": f"{plain(row['low_m'])} to {plain(row['high_m'])}",
        }
        for row in facts.get("recordings", ())
        if row["protocol"] == SHOWN_PROTOCOL
    ]
    return (
        f"{SHOWN_PROTOCOL.capitalize()}, first seed, with filter, repaired labels; other protocols stand in "
        "`results-facts.json`. Blocks of 30 s are resampled: errors that follow one another are alike.\n\n"
        f"### Against `{OURS}`\n\n{markdown_grid(_differences(facts, 'differences')) or MISSING}\n"
        "### Against the best at each place\n\nThe best is picked after the fact. The last columns are of the "
        "intervals in which both methods have a fix of their own.\n\n"
        f"{markdown_grid(_differences(facts, 'against_best')) or MISSING}\n"
        "### Recordings\n\nRMSE of each recording by itself, then the mean.\n\n"
        f"{markdown_grid(recordings) or MISSING}"
    )


def _differences(facts: Facts, name: str) -> list[dict[str, str]]:
    return [
        {
            "site": row["site"],
            "device": str(row["device"]),
            "method": row["method"],
            "against": row["base"],
            "difference in RMSE [m]": signed(row["rmse_m"]),
            "95 % of resamples [m]": f"{signed(row['low_m'])} to {signed(row['high_m'])}",
            "recordings in which it is worse": f"{row['recordings_below']} of {row['recordings']}",
            "both with a fix": UNKNOWN
            if row["common_share"] is None
            else f"{100 * row['common_share']:.0f} %",
            "RMSE there [m]": f"{plain(row['common_m'])}, {plain(row['common_base_m'])}",
        }
        for row in facts.get(name, ())
        if row["protocol"] == SHOWN_PROTOCOL
    ]


def stages(facts: Facts) -> str:
    """Return what each stage of the main chain leaves of the error."""
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
        f"{markdown_grid(rows) or MISSING}"
    )


def parts(facts: Facts) -> str:
    """Return what the default loses without a part of it, or with a wrong plan or survey."""
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
        "points, access points are moved under the plan; signals are made louder or fainter, ranges longer or "
        "shorter, as another phone might have them; parts are taken away without training again.\n\n"
        + (markdown_grid(table) or MISSING)
    )


def _both_devices(row: Mapping[str, str]) -> str:
    return "/".join(row[f"device {device}, RMSE [m]"] for device in (1, 2))


def offline(facts: Facts) -> str:
    """Return scores of the smoother."""
    rows = [
        {
            "site": record["site"],
            "device": str(record["device"]),
            "RMSE [m]": plain(record["rmse_m"]),
            "90 % [m]": plain(record["p90_m"]),
            "in the stated 95 % region": f"{100 * record['coverage95']:.0f} %",
            "NEES": plain(record["nees"]),
        }
        for record in facts.get("offline", ())
        if record["filter"] == OWN
    ]
    return (
        "`default` for zero-shot with every recording known to its end (`--smoother`), its own smoother, repaired "
        "labels, every interval. Nothing else on this page looks ahead.\n\n"
        + (markdown_grid(rows) or MISSING)
    )


def generator(facts: Facts) -> str:
    """Return generated beside measured data, and how fast they are made."""
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
        + ("".join(parts) or f"{MISSING}\n")
        + f"### Speed\n\n{markdown_grid(rates) or MISSING}"
    )


def complexity(book: RecordBook, facts: Facts) -> str:
    """Return parameters, FLOPs and milliseconds of the networks, and of all methods beside the paper's."""
    rows = [
        {
            "network": row["network"],
            "parameters": f"{row['parameters']:,}",
            "FLOPs": f"{row['flops']:,}",
            "ms": f"{row['ms']:.2f}",
            "paper's parameters": thousands(row["paper_parameters"]),
            "paper's FLOPs": thousands(row["paper_flops"]),
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
        f"{markdown_grid(rows) or MISSING}\n### Beside the paper\n\n"
        "The paper's milliseconds are of an RTX 3090 (networks) and of an i9-12900KF (rivals).\n\n"
        f"{markdown_grid(cost_rows(book, facts.get('complexity', ())))}"
    )


def timings(facts: Facts) -> str:
    """Return milliseconds of a fix, alone and in batches."""
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
        f"own.\n\n{markdown_grid(rows) or MISSING}"
    )


def load(facts: Facts) -> str:
    """Return how many phones the server keeps up with."""
    curve = facts.get("load_curve", ())
    rows = [
        {
            "method": row["method"],
            "phones": str(row["devices"]),
            "in time": f"{100 * row['within_200_ms']:.1f} %",
            "median [ms]": f"{row['latency_p50_ms']:.0f}",
            "99 % [ms]": f"{row['latency_p99_ms']:.0f}",
            "age, median [ms]": f"{row['age_p50_ms']:.0f}",
            "fairness": plain(row.get("accepted_fairness"), decimals=3),
        }
        for row in curve
    ]
    in_time: dict[str, int] = {}
    for row in curve:
        most = row["devices"] if row["within_200_ms"] >= IN_TIME else 0
        in_time[row["method"]] = max(most, in_time.get(row["method"], 0))
    up_to = listed(f"{devices} with `{method}`" for method, devices in in_time.items())
    return (
        "Phones at 5 Hz with 8 access points and `fploc serve` on one machine, by `make soak`; what else was "
        "measured stands in [load.md](load.md). In time: a live connection has the fix within 200 ms of its tick. "
        "Fairness: Jain's index of what was taken in of each phone, 1 where all got the same. 99 % are in time up to "
        f"this many phones: {up_to}.\n\n{markdown_grid(rows) or MISSING}"
    )


def training(facts: Facts) -> str:
    """Return seconds and links of each training."""
    rows = [
        {
            "preset": row.get("preset", UNKNOWN),
            "stage": row["stage"],
            "seconds": f"{row['seconds']:,.0f}",
            "links": thousands(row.get("links")),
        }
        for row in facts.get("training_cost", ())
    ]
    return markdown_grid(rows) or MISSING
