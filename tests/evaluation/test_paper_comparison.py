from __future__ import annotations

from collections.abc import Callable

import pytest

from fploc.evaluation.paper_comparison import (
    COST,
    COUNTERPARTS,
    comparison_sections,
    cost_rows,
    worse_sentences,
)
from fploc.evaluation.paper_numbers import paper_numbers
from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.selection import RecordBook
from fploc.evaluation.tables import NOT_RUN

MakeRecord = Callable[..., TrackedRecord]


def rows(text: str, *cells: str) -> list[list[str]]:
    """Return the cells of the table rows that begin with ``cells``."""
    found = [line.strip("| \n").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [row for row in found if row[: len(cells)] == list(cells)]


def test_every_number_of_the_paper_has_one_row() -> None:
    book = RecordBook([], "full")
    text = comparison_sections(book)
    numbers = [row for row in paper_numbers() if row.experiment != COST]
    assert {row.experiment for row in numbers} == set(COUNTERPARTS)
    for device in ("1", "2"):
        for site in {row.site for row in numbers}:
            expected = [row for row in numbers if (row.site, str(row.device)) == (site, device)]
            assert len(rows(text, site, device)) == len(expected)
    assert len(numbers) + len(cost_rows(book, [])) == len(paper_numbers())
    assert all(row[5].startswith(NOT_RUN) for row in rows(text, "office", "1"))


def test_ours_stands_beside_with_both_labels(made: MakeRecord) -> None:
    text = comparison_sections(RecordBook([made(1.25), made(1.5, labels="published")], "full"))
    (row,) = [row for row in rows(text, "shopping-mall", "1", "gnn-fpdnn+kf", "rmse_m") if row[4] == "1.19"]
    assert row[5:7] == ["1.25", "1.50"]


def test_several_methods_layouts_filters_and_pairs_share_a_cell_by_name(made: MakeRecord) -> None:
    pairs = {"protocol": "multi-device", "device": 2}
    records = [
        made(protocol="seen", site="office", method="rtt-rss", filter="none", p50_m=2.0),
        made(protocol="seen", site="office", method="bayes-grid", filter="own", p50_m=0.5),
        made(0.7, protocol="ap-moved", site="office-position1"),
        made(0.8, protocol="ap-moved", site="office-position2"),
        made(2.0, site="laboratory", filter="none"),
        made(1.5, site="laboratory"),
        *(
            made(value, **pairs, condition=f"two APs, {which}")
            for which, value in (("mean", 2.0), ("best", 1.0), ("worst", 3.0))
        ),
    ]
    text = comparison_sections(RecordBook(records, "full"))

    def ours(*cells: str) -> list[str]:
        return [row[5] for row in rows(text, *cells)]

    assert ours("office", "1", "rtt-rss / bayes-grid / cbt-wccg", "p50_m") == [
        "rtt-rss 2.00; bayes-grid 0.50"
    ]
    assert ours("office", "1", "gnn-fpdnn+kf", "rmse_m") == [
        NOT_RUN,
        "office-position1 0.70; office-position2 0.80",
        NOT_RUN,
    ]
    assert ours("laboratory", "1", "gnn-fpdnn", "rmse_m") == ["unfiltered 2.00; with KF 1.50"]
    assert ours("shopping-mall", "2", "gnn-fpdnn+kf", "rmse_m") == ["2.00 (1.00 to 3.00)"]


def test_layouts_without_published_labels_say_so(made: MakeRecord) -> None:
    text = comparison_sections(RecordBook([made(protocol="ap-moved", site="office-position1")], "full"))
    found = [row for row in rows(text, "office", "1", "gnn-fpdnn+kf", "rmse_m") if row[4] == "0.95"]
    assert [row[6] for row in found] == ["no published labels there"]


def test_only_what_is_above_the_papers_number_is_called_worse(made: MakeRecord) -> None:
    assert worse_sentences(RecordBook([made(1.19)], "full"), []) == []
    (sentence,) = worse_sentences(RecordBook([made(1.309), made(1.4, labels="published")], "full"), [])
    assert sentence.startswith("zero-shot, shopping-mall, device 1, gnn-fpdnn+kf: RMSE 1.31 m")
    assert "(published labels 1.40 m) for 1.19 m, 10 % more" in sentence
    assert sentence.endswith("No experiment here bears on it yet.")


def test_reconstructed_labels_and_bounds_rank_nothing(made: MakeRecord) -> None:
    records = [
        made(9.0, protocol="ap-moved", site="office-position1"),
        made(9.0, protocol="fine-tuned", site="office-position1"),
        made(9.0, protocol="seen", site="office", method="rtt-rss", filter="none"),
    ]
    assert worse_sentences(RecordBook(records, "full"), []) == []


def test_a_sentence_names_the_experiments_that_bear_on_it(made: MakeRecord) -> None:
    stages = [
        {
            "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "range_raw_mae_m": 0.9,
            "range_fpdnn_mae_m": 1.1, "GNN": 2.0, "GNN + KF": 1.8, "GNN + FPDNN": 1.6, "GNN + FPDNN + KF": 1.3,
        }
    ]  # fmt: skip
    records = [made(1.3), made(1.25, plan="blank"), made(1.2, protocol="multi-device")]
    records.append(made(1.4, protocol="multi-device", condition="without link"))
    alone, together = worse_sentences(RecordBook(records, "full"), stages)
    assert "0.90 m before FPDNN and 1.10 m after it" in alone and "real 1.30 m, blank 1.25 m" in alone
    assert "stage table of a device alone" in together and "RMSE without link 1.40 m" in together


def test_costs_of_networks_and_rivals_stand_in_their_own_columns(made: MakeRecord) -> None:
    complexity = [{"network": "gnn-paper", "parameters": 180, "flops": 1552, "ms": 0.6}]
    complexity.append({"network": "gnn", "parameters": 5282, "flops": 187_904, "ms": 2.4})
    book = RecordBook([made(method="rtt-rss", filter="none", ms_per_fix=0.25)], "full")
    by_key = {(row["method"], row["metric"]): row for row in cost_rows(book, complexity)}
    gnn = by_key["gnn", "flops"]
    assert (gnn["paper"], gnn["ours, published widths"], gnn["ours, small"]) == ("2704", "1,552", "187,904")
    assert by_key["gnn", "ms_per_sample"]["ours, small"] == "2.40"
    assert by_key["fpdnn", "parameters"]["ours, small"] == NOT_RUN
    assert by_key["rtt-rss", "ms_per_sample"]["ours, a rival's fix in a batch"] == "0.25"
    assert by_key["cbt-wccg", "ms_per_sample"]["ours, a rival's fix in a batch"] == NOT_RUN


@pytest.mark.parametrize("experiment", COUNTERPARTS)
def test_every_experiment_says_what_differs(experiment: str) -> None:
    assert COUNTERPARTS[experiment].differs.endswith(".")
