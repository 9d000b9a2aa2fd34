from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.records import Record
from fploc.evaluation.report import (
    UNKNOWN,
    TrackedRecord,
    comparison_rows,
    markdown,
    page,
    read_tracked_records,
)

RECORD = Record(
    method="gnn",
    protocol="zero-shot",
    site="shopping-mall",
    device=1,
    labels="repaired",
    calibration="source-los",
    plan="real",
    speed_prior=0.5,
    smoother=False,
    thin=1,
    filter="none",
    preset="full",
    seed=0,
    n=100,
    n_before_first_fix=0,
    no_fix_share=0.25,
    rmse_m=2.0,
    rmse_fixed_m=1.5,
    mae_m=1.0,
    p50_m=0.5,
    p90_m=3.0,
    p95_m=4.0,
    coverage95=0.9,
    nees=2.0,
    ms_per_fix=0.125,
    artifact=None,
    commit="abc",
)


def tracked(*changes: dict[str, object], made_up: bool = False) -> list[TrackedRecord]:
    return [
        TrackedRecord(replace(RECORD, **change), "run", "hash", made_up)  # type: ignore[arg-type]
        for change in changes
    ]


def test_one_record_is_one_row_with_the_papers_number_beside() -> None:
    (row,) = comparison_rows(tracked({}), labels="repaired")
    assert row == {
        "protocol": "zero-shot",
        "site": "shopping-mall",
        "device": "1",
        "method": "gnn",
        "filter": "none",
        "rmse_m": "2.00",
        "rmse_fixed_m": "1.50",
        "p50_m": "0.50",
        "p90_m": "3.00",
        "no fix": "0.25",
        "paper": "1.57",
        "ms/fix": "0.12",
    }


def test_seeds_become_mean_and_sample_deviation() -> None:
    records = tracked(*({"seed": seed, "rmse_m": value} for seed, value in enumerate((1.0, 2.0, 3.0))))
    (row,) = comparison_rows(records, labels="repaired")
    assert row["rmse_m"] == "2.00 ± 1.00" and row["rmse_fixed_m"] == "1.50 ± 0.00"


def test_everything_but_the_seed_is_a_row_of_its_own() -> None:
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


def test_kinds_of_labels_are_never_mixed() -> None:
    records = tracked({"labels": "published", "rmse_m": 9.0}, {})
    assert [row["rmse_m"] for row in comparison_rows(records, labels="repaired")] == ["2.00"]
    assert [row["rmse_m"] for row in comparison_rows(records, labels="published")] == ["9.00"]


@pytest.mark.parametrize("values", [[None], [None, None]])
def test_what_is_not_defined_is_a_dash(values: list[None]) -> None:
    records = tracked(*({"seed": seed, "rmse_m": value} for seed, value in enumerate(values)))
    (row,) = comparison_rows(records, labels="repaired")
    assert row["rmse_m"] == UNKNOWN


def test_a_seed_without_a_number_leaves_the_others() -> None:
    (row,) = comparison_rows(tracked({"rmse_m": None}, {"seed": 1}), labels="repaired")
    assert row["rmse_m"] == "2.00"


def test_markdown_holds_one_line_for_each_row() -> None:
    assert markdown([{"a": "1", "b": "2"}]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert markdown([]) == ""


def test_a_page_of_public_data_shows_both_labels_and_the_papers_numbers() -> None:
    text = page(tracked({}, {"labels": "published"}), preset="full")
    assert "## Repaired labels" in text and "## Published labels" in text
    assert "development sites" in text and "## The paper's own numbers" in text
    assert "fploc reproduce --preset full" in text and "Revision abc." in text
    assert "ade-up" not in text


def test_a_page_of_made_up_buildings_says_so_and_compares_nothing() -> None:
    text = page(tracked({"site": "made-up-2", "commit": None}, made_up=True), preset="smoke")
    assert "**Made-up buildings.**" in text and "Revision unknown." in text
    assert "## The paper's own numbers" not in text
    assert f"| {UNKNOWN} |" in text


def test_a_line_of_a_records_file_is_the_record_and_where_it_came_from() -> None:
    (one,) = tracked({})
    assert list(one.as_json()) == [*RECORD.as_json(), "run_id", "data_hash", "made_up"]


def test_records_are_read_back_as_they_were(tmp_path: Path) -> None:
    records = tracked({}, {"device": 2, "rmse_m": None}, made_up=True)
    file = tmp_path / "records.jsonl"
    file.write_text("".join(json.dumps(one.as_json()) + "\n" for one in records))
    assert read_tracked_records(file) == records


@pytest.mark.parametrize("line", ["", "[1]", '{"run_id": 1}', "{", "3"])
def test_a_line_that_is_no_record_is_named(line: str, tmp_path: Path) -> None:
    (one,) = tracked({})
    file = tmp_path / "records.jsonl"
    file.write_text(f"{json.dumps(one.as_json())}\n{line}\n")
    with pytest.raises(BadFileError, match=r"records\.jsonl, line 2: found .*make it again"):
        read_tracked_records(file)


def test_a_missing_file_of_records_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"none\.jsonl: found nothing"):
        read_tracked_records(tmp_path / "none.jsonl")
