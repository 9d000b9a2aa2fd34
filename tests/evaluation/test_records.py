from __future__ import annotations

import json
from collections.abc import Callable
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


@pytest.fixture(scope="module")
def tracked(made: Callable[..., TrackedRecord]) -> TrackedRecord:
    return made(2.6, nees=None)


def test_the_fields_are_those_of_the_command_line_in_their_order(tracked: TrackedRecord) -> None:
    expected = (
        "method protocol site device labels calibration plan speed_prior smoother thin filter preset seed n "
        "n_before_first_fix no_fix_share rmse_m rmse_fixed_m mae_m p50_m p90_m p95_m coverage95 nees ms_per_fix "
        "artifact commit condition"
    )
    assert [one.name for one in fields(Record)] == expected.split()
    assert list(tracked.record.as_json()) == expected.split()


def test_a_line_of_a_records_file_is_the_record_and_where_it_came_from(tracked: TrackedRecord) -> None:
    assert list(tracked.as_json()) == [*tracked.record.as_json(), "run_id", "data_hash", "made_up"]


def test_records_survive_the_disk(tracked: TrackedRecord, tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    other = replace(tracked.record, device=2, rmse_m=None, condition="without link")
    records = [tracked, replace(tracked, record=other, made_up=True)]
    write_records(records, path)
    assert read_tracked_records(path) == records
    assert [one.name for one in tmp_path.iterdir()] == ["records.jsonl"]


def test_a_record_without_a_run_is_written_without_one(tracked: TrackedRecord, tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records([tracked.record], path)
    assert json.loads(path.read_text()) == tracked.record.as_json()


def test_a_record_from_before_there_were_conditions_has_none(tracked: TrackedRecord) -> None:
    values = tracked.as_json()
    del values["condition"]
    assert tracked_record(json.dumps(values)) == tracked


@pytest.mark.parametrize("line", ["", "[1]", '{"run_id": 1}', "{", "3"])
def test_a_line_that_is_no_record_is_named(tracked: TrackedRecord, line: str, tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records([tracked], path)
    path.write_text(f"{path.read_text()}{line}\n")
    with pytest.raises(BadFileError, match=r"records\.jsonl, line 2: found .*make it again"):
        read_tracked_records(path)


def test_a_missing_file_of_records_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"none\.jsonl: found nothing"):
        read_tracked_records(tmp_path / "none.jsonl")


def test_json_holds_no_nan() -> None:
    assert [finite_or_none(value) for value in (1.5, float("nan"), float("inf"))] == [1.5, None, None]
