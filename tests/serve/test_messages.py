from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from fploc.serve.messages import MOST_INTERVALS, MOST_READINGS, Measurements

READING = {"bssid": "00:11:22:33:44:55", "range_m": 3.2, "range_std_m": 0.1, "rss_dbm": -60.0}
GOOD: dict[str, Any] = {
    "version": 1,
    "device": "phone-1",
    "intervals": [{"t_ms": 12.5, "readings": [READING]}],
}


def changed(**changes: object) -> dict[str, Any]:
    return GOOD | changes


def with_reading(**changes: object) -> dict[str, Any]:
    return changed(intervals=[{"t_ms": 12.5, "readings": [READING | changes]}])


def test_a_message_goes_through_json_unchanged() -> None:
    message = Measurements.model_validate(GOOD)
    assert Measurements.model_validate_json(message.model_dump_json()) == message
    assert message.intervals[0].readings[0].range_m == 3.2


@pytest.mark.parametrize(
    "bad",
    [
        with_reading(range_m=math.nan),
        with_reading(range_m=math.inf),
        with_reading(range_m=-11.0),
        with_reading(range_m=1e9),
        with_reading(range_m="3.2"),
        with_reading(range_m=True),
        with_reading(range_std_m=-0.1),
        with_reading(rss_dbm=-1000),
        with_reading(bssid="00:11:22:33:44"),
        with_reading(bssid="00:11:22:33:44:5５"),
        with_reading(extra=1),
        changed(device=""),
        changed(device="../../etc/passwd"),
        changed(device="x" * 65),
        changed(device="Gerät"),
        changed(device="a\n"),
        changed(device=7),
        changed(version=2),
        changed(intervals=[]),
        changed(intervals=[GOOD["intervals"][0]] * (MOST_INTERVALS + 1)),
        changed(intervals=[{"t_ms": -1, "readings": []}]),
        changed(intervals=[{"t_ms": 1, "readings": [READING] * (MOST_READINGS + 1)}]),
        changed(intervals=[{"t_ms": 1}]),
        changed(intervals={"0": GOOD["intervals"][0]}),
        [GOOD],
        None,
    ],
)
def test_what_does_not_fit_is_refused(bad: object) -> None:
    with pytest.raises(ValidationError):
        Measurements.model_validate(bad)
    with pytest.raises(ValidationError):
        Measurements.model_validate_json(json.dumps(bad))


NUMBERS = st.one_of(st.floats(), st.integers(), st.text(), st.none(), st.booleans())


@settings(deadline=None, max_examples=50, database=None, derandomize=True)
@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_message_is_refused_or_holds_finite_numbers(t_ms: object, range_m: object, rss_dbm: object) -> None:
    raw = changed(
        intervals=[{"t_ms": t_ms, "readings": [READING | {"range_m": range_m, "rss_dbm": rss_dbm}]}]
    )
    try:
        interval = Measurements.model_validate(raw).intervals[0]
    except ValidationError:
        return
    (reading,) = interval.readings
    assert 0.0 <= interval.t_ms < math.inf
    assert reading.range_m is None or -10.0 <= reading.range_m <= 1000.0
    assert reading.rss_dbm is None or -150.0 <= reading.rss_dbm <= 50.0
