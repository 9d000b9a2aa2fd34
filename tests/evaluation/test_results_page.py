from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.results_page import results_page
from fploc.evaluation.tables import UNKNOWN

MakeRecord = Callable[..., TrackedRecord]


def section(page: str, title: str) -> str:
    (text,) = re.findall(rf"\n## {re.escape(title)}\n(.*?)(?=\n## |\Z)", page, re.DOTALL)
    return str(text)


def rows(text: str) -> list[list[str]]:
    return [line.strip("|\n ").split(" | ") for line in text.splitlines() if line.startswith("| ")]


def test_a_page_without_anything_has_every_section_and_says_what_was_not_run() -> None:
    page = results_page([], {})
    titles = re.findall(r"^## (.+)$", page, re.MULTILINE)
    assert len(titles) == len(set(titles)) == 21
    for title in (
        "Stage by stage",
        "What the plan is worth",
        "Ablations",
        "Published widths",
        "Cost of training",
    ):
        assert "Not run." in section(page, title)
    assert "nan" not in page and "None" not in page


def test_tables_are_whole(made: MakeRecord) -> None:
    page = results_page([made(), made(method="nls"), made(protocol="seen", site="office")], FACTS)
    for table in re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE):
        widths = {line.count(" | ") for line in table.splitlines()}
        assert len(widths) == 1, table


def test_made_up_buildings_are_not_laid_beside_the_paper(made: MakeRecord) -> None:
    page = results_page([made(site="made-up-2", made_up=True)], {})
    assert "**Made-up buildings.**" in page and "1.19" not in page
    assert "The paper's numbers" not in page and "made-up-2 1" in section(page, "All methods")


def test_the_headline_is_held_against_the_goal(made: MakeRecord) -> None:
    records = [made(0.9), made(0.95, labels="published"), made(1.3, site="laboratory")]
    text = section(results_page(records, {}), "Headline")
    mall, laboratory = rows(text)[2:]
    assert mall == ["shopping-mall", "0.90", "0.95", "1.19 m", "1.00 m", "yes"]
    assert laboratory[-1] == "no" and laboratory[2] == UNKNOWN


def test_plans_are_laid_against_the_real_one(made: MakeRecord) -> None:
    records = [made(1.0), made(1.1, plan="blank"), made(0.9, plan="library"), made(5.0, site="laboratory")]
    text = section(results_page(records, {}), "What the plan is worth")
    assert rows(text) == [
        ["plan", "shopping-mall 1"],
        ["---", "---"],
        ["real", "1.00"],
        ["blank", "1.10 (+10.0 %)"],
        ["library", "0.90 (−10.0 %)"],
    ]


def test_ablations_are_differences_over_the_seeds_that_both_have(made: MakeRecord) -> None:
    records = [
        *(made(value, seed=seed) for seed, value in enumerate((1.0, 2.0, 6.0))),
        *(made(value, seed=seed, preset="full--bare") for seed, value in enumerate((1.5, 2.7))),
    ]
    text = section(
        results_page(records, {"ablations": {"bare": "As published.", "other": "Why."}}), "Ablations"
    )
    assert rows(text)[2:] == [
        ["none", "3", "3.00 ± 2.65", "the preset as it is"],
        ["bare", "2", "+0.60 ± 0.14", "As published."],
        ["other", "0", UNKNOWN, "Why."],
    ]
    assert "Not run: other." in text


def test_all_methods_stand_by_places_and_thinned_tables_apart(made: MakeRecord) -> None:
    records = [
        made(1.0, p50_m=0.5, p90_m=1.5),
        made(2.0, device=2),
        made(3.0, method="bayes-grid", filter="own"),
        made(4.0, thin=10),
        made(5.0, condition="without link", protocol="multi-device"),
    ]
    text = section(results_page(records, {}), "All methods")
    tables = dict(re.findall(r"### (.+)\n\n((?:\|.*\n)+)", text + "\n"))
    assert rows(tables["zero-shot: with KF, repaired labels, RMSE"])[2:] == [
        ["gnn-fpdnn", "1.00", "2.00"],
        ["bayes-grid", "3.00", UNKNOWN],
    ]
    assert rows(tables["zero-shot: with KF, repaired labels, median and 90 %"])[2][1] == "0.50, 1.50"
    assert rows(tables["zero-shot: with KF, repaired labels, RMSE, every 10th interval"])[2][1] == "4.00"
    assert rows(tables["multi-device: with KF, repaired labels, RMSE"])[2] == [
        "gnn-fpdnn",
        "without link",
        "5.00",
    ]
    assert "zero-shot: with KF, published labels, RMSE" not in tables


def test_revisions_of_trainings_and_of_scorings_are_told_apart(made: MakeRecord) -> None:
    costs = [{"stage": name, "seconds": 1.0, "commit": commit} for name, commit in (("a", "b1"), ("b", "a2"))]
    text = results_page([made()], {"training_cost": [*costs, {"stage": "c", "seconds": 1.0}]})
    assert "Trained at revision a2, b1, –; scored at revision abc." in text


def test_published_widths_stand_apart(made: MakeRecord) -> None:
    page = results_page([made(3.0, preset="published", thin=10), made(2.0)], {})
    text = section(page, "Published widths")
    assert "every 10th interval" in text and rows(text)[2][5] == "3.00"
    assert "3.00" not in section(page, "All methods")


def test_facts_stand_in_their_tables() -> None:
    page = results_page([], FACTS)
    assert rows(section(page, "Stage by stage"))[2] == [
        "zero-shot", "shopping-mall", "1", "0.95 ± 0.07", "0.80", "2.00", "1.80", "1.50", UNKNOWN,
    ]  # fmt: skip
    sure = section(page, "How sure the differences are")
    assert [
        "shopping-mall", "1", "nls", "gnn-fpdnn", "+0.22", "−0.15 to +0.28", "3 of 4", "40 %", "1.20, 1.00",
    ] in rows(sure)  # fmt: skip
    assert ["shopping-mall", "1", "nls", "bayes-grid"] in [row[:4] for row in rows(sure)]
    assert ["nls", "1", "64", "0.012", "0.034"] in rows(section(page, "Time of a fix"))
    load = section(page, "The server under load")
    assert ["nls", "100", "99.8 %", "24", "90", "121", "0.999"] in rows(load)
    assert (
        "[load.md](load.md)" in load and "up to this many phones: 0 with `default`, 100 with `nls`." in load
    )
    assert ["shopping-mall", "1", "nls", "4", "0.95", "0.96", "0.84 to 1.02"] in rows(sure)
    assert "seen" not in {row[0] for row in rows(sure)}
    assert ["gnn", "5,282", "187,904", "2.39", "1,381", "2,704"] in rows(section(page, "Complexity"))
    generated = section(page, "Generated and measured data")
    assert ["AP1", "measured", "1,234"] in [row[:3] for row in rows(generated)]
    assert ["small", "5,123"] in rows(generated)
    assert [UNKNOWN, "train--generator--seed-0", "61", UNKNOWN] in rows(section(page, "Cost of training"))


STAGE = {
    "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "labels": "repaired", "links": 10.0,
    "range_raw_mae_m": 0.9, "range_fpdnn_mae_m": 0.8, "GNN": 2.0, "GNN + KF": 1.8, "GNN + FPDNN": 1.5,
    "GNN + FPDNN + KF": None,
}  # fmt: skip
DIFFERENCE = {
    "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "method": "nls", "base": "gnn-fpdnn",
    "rmse_m": 0.22, "low_m": -0.15, "high_m": 0.28, "recordings": 4, "recordings_below": 3,
    "common_share": 0.4, "common_m": 1.2, "common_base_m": 1.0,
}  # fmt: skip
RECORDING = {
    "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "method": "nls", "recordings": 4,
    "rmse_m": 0.95, "rmse_by_arc_m": 0.96, "low_m": 0.84, "high_m": 1.02,
}  # fmt: skip
STATISTICS = dict.fromkeys(
    (
        "bias_m", "spread_m", "skewness", "local_spread_m", "local_skewness", "rss_dbm", "rss_bias_db",
        "rss_spread_db", "dependence",
    ),
    0.5,
)  # fmt: skip
WORTH = {
    "site": "shopping-mall", "what": "plan", "changed": "blank",
    "device 1, RMSE [m]": "0.51", "device 2, RMSE [m]": "0.92",
}  # fmt: skip
OFFLINE = {
    "site": "library", "device": 1, "filter": "own", "rmse_m": 0.591, "p90_m": 0.97, "coverage95": 0.954,
    "nees": 1.23,
}  # fmt: skip
LOADED = {
    "method": "nls", "devices": 100, "within_200_ms": 0.998, "latency_p50_ms": 24.2, "latency_p99_ms": 90.4,
    "age_p50_ms": 121.0, "accepted_fairness": 0.9991,
}  # fmt: skip
FACTS: dict[str, Any] = {
    "chain_stages": [
        STAGE,
        STAGE | {"range_raw_mae_m": 1.0, "range_fpdnn_mae_m": None, "GNN": None, "GNN + KF": None}
        | {"GNN + FPDNN": None},
    ],
    "differences": [DIFFERENCE, DIFFERENCE | {"protocol": "seen", "site": "seen"}],
    "against_best": [DIFFERENCE | {"base": "bayes-grid"}],
    "timings": [{"method": "nls", "threads": 1, "batch": 64, "median_ms": 0.012, "p90_ms": 0.034}],
    "plan_worth": [
        WORTH,
        WORTH | {"site": "library", "device 1, RMSE [m]": "0.70"},
        WORTH | {"what": "part", "changed": "nobody walks"},
    ],
    "offline": [OFFLINE, OFFLINE | {"filter": "kalman", "rmse_m": 9.87}],
    "load_curve": [
        LOADED,
        LOADED | {"devices": 200, "within_200_ms": 0.5},
        LOADED | {"method": "default", "within_200_ms": 0.98, "accepted_fairness": None},
    ],
    "recordings": [RECORDING, RECORDING | {"protocol": "seen", "site": "seen"}],
    "complexity": [
        {
            "network": "gnn", "parameters": 5282, "flops": 187_904, "ms": 2.386, "paper_parameters": 1381,
            "paper_flops": 2704,
        }
    ],
    "generator_match": [
        {
            "site": "office", "kind": "held-out recordings of the source",
            "rows": [{"access_point": "AP1", "data": "measured", "n": 1234} | STATISTICS],
        }
    ],
    "virtual_rates": {"small": 5123.4},
    "training_cost": [{"stage": "train--generator--seed-0", "seconds": 61.2}],
    "ablations": {},
}  # fmt: skip


def test_what_the_default_owes_to_plan_and_parts_has_a_column_for_each_site() -> None:
    page = results_page([], FACTS)
    section = page.split("## What plan, survey, phone and parts are worth to the default")[1].split("\n## ")[
        0
    ]
    assert "| what | changed | shopping-mall | library |" in section
    assert "| plan | blank | 0.51/0.92 | 0.70/0.92 |" in section
    assert "| part | nobody walks | 0.51/0.92 | – |" in section


def test_offline_shows_the_smoother_of_the_method_alone() -> None:
    section = results_page([], FACTS).split("## Offline")[1].split("\n## ")[0]
    assert "| library | 1 | 0.59 | 0.97 | 95 % | 1.23 |" in section
    assert "9.87" not in section
