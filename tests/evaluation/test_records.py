from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.records import (
    Record,
    TrackedRecord,
    finite_or_none,
    read_tracked_records,
    tracked_record,
    write_records,
)

RECORD = Record(
    method="nls",
    protocol="zero-shot",
    site="shopping-mall",
    device=1,
    labels="published",
    calibration="none",
    plan="real",
    speed_prior=0.5,
    smoother=False,
    thin=1,
    filter="none",
    preset="default",
    seed=0,
    n=10,
    n_before_first_fix=2,
    no_fix_share=0.1,
    rmse_m=2.6,
    rmse_fixed_m=2.5,
    mae_m=2.0,
    p50_m=1.6,
    p90_m=4.4,
    p95_m=5.0,
    coverage95=0.9,
    nees=None,
    ms_per_fix=0.3,
    artifact=None,
    commit=None,
)


def test_the_fields_are_those_of_the_command_line_in_their_order() -> None:
    expected = (
        "method protocol site device labels calibration plan speed_prior smoother thin filter preset seed n "
        "n_before_first_fix no_fix_share rmse_m rmse_fixed_m mae_m p50_m p90_m p95_m coverage95 nees ms_per_fix "
        "artifact commit condition"
    )
    assert [one.name for one in fields(Record)] == expected.split()
    assert list(RECORD.as_json()) == expected.split()


TRACKED = TrackedRecord(RECORD, "run", "hash", made_up=False)


def test_a_line_of_a_records_file_is_the_record_and_where_it_came_from() -> None:
    assert list(TRACKED.as_json()) == [*RECORD.as_json(), "run_id", "data_hash", "made_up"]


def test_records_survive_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    other = replace(RECORD, device=2, rmse_m=None, condition="without link")
    records = [TRACKED, replace(TRACKED, record=other, made_up=True)]
    write_records(records, path)
    assert read_tracked_records(path) == records
    assert [one.name for one in tmp_path.iterdir()] == ["records.jsonl"]


def test_a_record_without_a_run_is_written_without_one(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records([RECORD], path)
    assert json.loads(path.read_text()) == RECORD.as_json()


def test_a_record_from_before_there_were_conditions_has_none() -> None:
    values = TRACKED.as_json()
    del values["condition"]
    assert tracked_record(json.dumps(values)) == TRACKED


@pytest.mark.parametrize("line", ["", "[1]", '{"run_id": 1}', "{", "3"])
def test_a_line_that_is_no_record_is_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records([TRACKED], path)
    path.write_text(f"{path.read_text()}{line}\n")
    with pytest.raises(BadFileError, match=r"records\.jsonl, line 2: found .*make it again"):
        read_tracked_records(path)


def test_a_missing_file_of_records_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"none\.jsonl: found nothing"):
        read_tracked_records(tmp_path / "none.jsonl")


def test_json_holds_no_nan() -> None:
    assert [finite_or_none(value) for value in (1.5, float("nan"), float("inf"))] == [1.5, None, None]
