from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.records import Record, finite_or_none, read_records, write_records

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
        "artifact commit"
    )
    assert [one.name for one in fields(Record)] == expected.split()
    assert list(RECORD.as_json()) == expected.split()


def test_records_survive_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    records = [RECORD, replace(RECORD, device=2, rmse_m=None)]
    write_records(records, path)
    assert read_records(path) == records
    assert [one.name for one in tmp_path.iterdir()] == ["records.jsonl"]


@pytest.mark.parametrize("line", ["", "{", "[]", "{}", '{"method": "nls"}'])
def test_a_broken_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "records.jsonl"
    write_records([RECORD], path)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(BadFileError, match=r"records\.jsonl, line 2"):
        read_records(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"records\.jsonl"):
        read_records(tmp_path / "records.jsonl")


def test_json_holds_no_nan() -> None:
    assert [finite_or_none(value) for value in (1.5, float("nan"), float("inf"))] == [1.5, None, None]
