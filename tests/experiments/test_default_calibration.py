"""Which calibration a method without training runs with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fploc.errors import UnknownNameError
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.experiments.scoring import answer
from fploc.methods.registry import default_calibration

REQUEST = EvaluationRequest("zero-shot", "laboratory", device="2", labels="published", thin=40)


def test_every_method_names_its_calibration() -> None:
    assert default_calibration("bayes-grid") == "none"
    assert default_calibration("lls") == "source-median"
    with pytest.raises(UnknownNameError, match="'magic'"):
        default_calibration("magic")


@pytest.mark.parametrize(
    ("method", "asked", "used"),
    [("bayes-grid", None, "none"), ("bayes-grid", "1.0", "1.0"), ("lls", None, "source-median")],
)
def test_records_say_which_calibration_was_used(
    method: str, asked: str | None, used: str, data_root: Path, tmp_path: Path
) -> None:
    request = REQUEST if asked is None else replace(REQUEST, calibration=asked)
    records = answer(method, request, asked, data_root, tmp_path)
    assert {record.calibration for record in records} == {used}
    again = answer(method, replace(REQUEST, calibration=used), used, data_root, tmp_path)
    assert [record.rmse_m for record in records] == [record.rmse_m for record in again]
