from __future__ import annotations

import json

import numpy as np
import pytest

from fploc.evaluation.certainty import difference_rows, recording_rows, rows_against_best
from fploc.evaluation.error_series import ErrorSeries


def series(
    device: int,
    name: str,
    errors: list[float],
    *,
    arc_m: float = 1.0,
    start_s: float = 0.0,
    fixed: list[bool] | None = None,
) -> ErrorSeries:
    array = np.array(errors)
    times = start_s + 10.0 * np.arange(len(errors))
    own = np.ones(len(errors), dtype=np.bool_) if fixed is None else np.array(fixed)
    return ErrorSeries(device, name, arc_m, times, np.full_like(array, 99.0), array, own)


def test_differences_are_between_filtered_errors_of_the_same_intervals() -> None:
    base = [series(1, "a", [1.0] * 6), series(1, "b", [2.0] * 6)]
    other = [series(1, "a", [3.0] * 8), series(1, "b", [1.0] * 6), series(1, "c", [50.0])]
    (row,) = difference_rows({"base": base, "other": other}, base="base")
    assert row["rmse_m"] == pytest.approx(np.sqrt((9 + 1) / 2) - np.sqrt((1 + 4) / 2))
    assert (row["device"], row["method"], row["base"]) == (1, "other", "base")
    assert (row["recordings"], row["recordings_below"]) == (2, 1)
    assert row["low_m"] < row["rmse_m"] < row["high_m"]
    json.dumps(row, allow_nan=False)


def test_devices_are_apart_and_nothing_in_common_is_no_number() -> None:
    base = [series(1, "a", [1.0]), series(2, "b", [1.0])]
    other = [series(1, "a", [2.0]), series(2, "b", [4.0], start_s=5.0)]
    first, second = difference_rows({"base": base, "other": other}, base="base")
    assert (first["rmse_m"], first["low_m"], first["high_m"]) == (1.0, 1.0, 1.0)
    assert second["rmse_m"] is None and second["recordings"] == 0
    assert difference_rows({"other": other}, base="base") == []


def test_methods_are_compared_where_both_have_a_fix_as_well() -> None:
    base = [series(1, "a", [1.0, 2.0, 3.0, 4.0], fixed=[True, True, False, False])]
    other = [series(1, "a", [5.0, 6.0, 7.0, 8.0], fixed=[False, True, True, False])]
    (row,) = difference_rows({"base": base, "other": other}, base="base")
    assert (row["common_m"], row["common_base_m"], row["common_share"]) == (6.0, 2.0, 0.25)
    never = [series(1, "a", [1.0] * 4, fixed=[False] * 4)]
    (row,) = difference_rows({"base": never, "other": other}, base="base")
    assert (row["common_m"], row["common_base_m"], row["common_share"]) == (None, None, 0.0)


def test_the_best_of_each_device_is_what_the_others_are_compared_with() -> None:
    given = {
        "one": [series(1, "a", [1.0] * 3), series(2, "b", [2.0] * 3)],
        "other": [series(1, "a", [3.0] * 3), series(2, "b", [1.0] * 3)],
    }
    found = [(row["device"], row["base"], row["method"], row["rmse_m"]) for row in rows_against_best(given)]
    assert found == [(1, "one", "other", 2.0), (2, "other", "one", 1.0)]
    assert rows_against_best({}) == []


def test_recordings_count_alike_or_by_their_length() -> None:
    given = [
        series(1, "a", [1.0] * 9, arc_m=30.0),
        series(1, "b", [3.0], arc_m=10.0),
        series(2, "c", [np.nan]),
    ]
    first, second = recording_rows({"gnn": given})
    assert first == {
        "device": 1, "method": "gnn", "recordings": 2,
        "rmse_m": 2.0, "rmse_by_arc_m": 1.5, "low_m": 1.0, "high_m": 3.0,
    }  # fmt: skip
    assert second["recordings"] == 0 and second["rmse_m"] is None and second["low_m"] is None
