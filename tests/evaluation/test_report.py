from __future__ import annotations

from collections.abc import Callable

import pytest

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.report import comparison_rows, headline_records, page
from fploc.evaluation.tables import UNKNOWN

PLAIN: dict[str, object] = {
    "method": "gnn", "filter": "none", "no_fix_share": 0.25, "rmse_m": 2.0, "rmse_fixed_m": 1.5, "mae_m": 1.0,
    "p50_m": 0.5, "p90_m": 3.0, "p95_m": 4.0, "ms_per_fix": 0.125,
}  # fmt: skip

MakeRecords = Callable[..., list[TrackedRecord]]


@pytest.fixture
def tracked(made: Callable[..., TrackedRecord]) -> MakeRecords:
    """Return what makes a record for each mapping of changes: unfiltered ones of the GNN."""

    def tracked(*changes: dict[str, object], made_up: bool = False) -> list[TrackedRecord]:
        return [made(made_up=made_up, **PLAIN | change) for change in changes]

    return tracked


def test_one_record_is_one_row_with_the_papers_number_beside(tracked: MakeRecords) -> None:
    (row,) = comparison_rows(tracked({}), labels="repaired")
    assert row == {
        "protocol": "zero-shot",
        "site": "shopping-mall",
        "device": "1",
        "method": "gnn",
        "filter": "none",
        "setting": UNKNOWN,
        "rmse_m": "2.00",
        "rmse_fixed_m": "1.50",
        "p50_m": "0.50",
        "p90_m": "3.00",
        "no fix": "0.25",
        "paper": "1.57",
        "ms/fix": "0.12",
    }


def test_seeds_become_mean_and_sample_deviation(tracked: MakeRecords) -> None:
    records = tracked(*({"seed": seed, "rmse_m": value} for seed, value in enumerate((1.0, 2.0, 3.0))))
    (row,) = comparison_rows(records, labels="repaired")
    assert row["rmse_m"] == "2.00 ± 1.00" and row["rmse_fixed_m"] == "1.50 ± 0.00"


def test_everything_but_the_seed_is_a_row_of_its_own(tracked: MakeRecords) -> None:
    changes: list[dict[str, object]] = [
        {},
        {"filter": "kalman"},
        {"device": 2},
        {"site": "laboratory"},
        {"method": "nls"},
        {"protocol": "seen"},
        {"seed": 1},
    ]
    rows = comparison_rows(tracked(*changes), labels="repaired")
    assert len(rows) == len(changes) - 1
    assert [row["filter"] for row in rows[:2]] == ["none", "KF"]
    assert [row["paper"] for row in rows[:2]] == ["1.57", "1.23"]


def test_kinds_of_labels_are_never_mixed(tracked: MakeRecords) -> None:
    records = tracked({"labels": "published", "rmse_m": 9.0}, {})
    assert [row["rmse_m"] for row in comparison_rows(records, labels="repaired")] == ["2.00"]
    assert [row["rmse_m"] for row in comparison_rows(records, labels="published")] == ["9.00"]


@pytest.mark.parametrize("values", [[None], [None, None]])
def test_what_is_not_defined_is_a_dash(tracked: MakeRecords, values: list[None]) -> None:
    records = tracked(*({"seed": seed, "rmse_m": value} for seed, value in enumerate(values)))
    (row,) = comparison_rows(records, labels="repaired")
    assert row["rmse_m"] == UNKNOWN


def test_a_seed_without_a_number_leaves_the_others(tracked: MakeRecords) -> None:
    (row,) = comparison_rows(tracked({"rmse_m": None}, {"seed": 1}), labels="repaired")
    assert row["rmse_m"] == "2.00"


def test_a_page_of_public_data_shows_both_labels_and_the_papers_numbers(tracked: MakeRecords) -> None:
    text = page(tracked({}, {"labels": "published"}), preset="full")
    assert "## Repaired labels" in text and "## Published labels" in text
    assert "development sites" in text and "## The paper's own numbers" in text
    assert "fploc reproduce --preset full" in text and "Revision abc." in text
    assert "ade-up" not in text


def test_a_page_of_made_up_buildings_says_so_and_compares_nothing(tracked: MakeRecords) -> None:
    text = page(tracked({"site": "made-up-2", "commit": None}, made_up=True), preset="smoke")
    assert "**Made-up buildings.**" in text and "Revision unknown." in text
    assert "## The paper's own numbers" not in text
    assert f"| {UNKNOWN} |" in text


def test_what_differs_from_the_plain_evaluation_is_a_row_of_its_own_beside_no_published_number(
    tracked: MakeRecords,
) -> None:
    changes: list[dict[str, object]] = [
        {},
        {"plan": "blank"},
        {"thin": 10},
        {"condition": "without link"},
        {"preset": "full--no-norm", "plan": "blank", "thin": 10},
    ]
    rows = comparison_rows(tracked(*changes), labels="repaired")
    assert [row["setting"] for row in rows] == [
        UNKNOWN, "plan blank", "thin 10", "without link", "no-norm; plan blank; thin 10",
    ]  # fmt: skip
    assert [row["paper"] for row in rows] == ["1.57", *[UNKNOWN] * 4]


def test_headlines_are_the_least_thinned_plain_records(tracked: MakeRecords) -> None:
    changes: list[dict[str, object]] = [
        {"thin": 10},
        {"thin": 2},
        {"thin": 2, "seed": 1},
        {"plan": "blank"},
        {"condition": "without link"},
        {"preset": "full--no-norm"},
    ]
    records = tracked(*changes)
    assert headline_records(records) == records[1:3]
    assert headline_records([]) == []
