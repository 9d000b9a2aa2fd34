"""Evaluation on the public measurements; the numbers are the issue's outside checks of parsing and solving."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fploc.calibration.offsets import RangeOffsets
from fploc.errors import FplocError, MissingFileError
from fploc.evaluation.evaluate import EvaluationRequest, evaluate, records_of, source_offsets, tracks_of
from fploc.evaluation.records import Record
from fploc.evaluation.revision import running_commit
from fploc.methods.registry import geometric_method

MALL = EvaluationRequest("zero-shot", "shopping-mall", calibration="none", labels="published")
LABORATORY = EvaluationRequest("zero-shot", "laboratory", calibration="none", labels="published")
OFFICE = EvaluationRequest("seen", "office", device="1", calibration="source-los", thin=20)
SHORT = replace(LABORATORY, device="2")


def run(request: EvaluationRequest, data_root: Path, method: str = "nls") -> list[Record]:
    return evaluate(geometric_method(method), request, data_root)


def chosen(records: list[Record], **wanted: object) -> Record:
    (one,) = [
        record for record in records if all(getattr(record, name) == value for name, value in wanted.items())
    ]
    return one


@pytest.mark.parametrize(
    ("request_", "expected"),
    [(MALL, {1: (2.62, 0.1), 2: (6.9, 0.5)}), (LABORATORY, {1: (4.59, 0.1), 2: (4.29, 0.1)})],
    ids=["shopping-mall", "laboratory"],
)
def test_nls_without_calibration_meets_the_outside_checks(
    request_: EvaluationRequest, expected: dict[int, tuple[float, float]], data_root: Path
) -> None:
    records = run(request_, data_root)
    for device, (metres, tolerance) in expected.items():
        found = chosen(records, device=device, filter="none").rmse_fixed_m
        assert found == pytest.approx(metres, abs=tolerance)


@pytest.mark.parametrize(("calibration", "metres"), [("1.0", 1.52), ("2.4", 1.10)])
def test_nls_with_an_offset_meets_the_outside_checks(
    calibration: str, metres: float, data_root: Path
) -> None:
    records = run(replace(MALL, device="1", calibration=calibration), data_root)
    assert chosen(records, filter="none").rmse_fixed_m == pytest.approx(metres, abs=0.03)


def test_the_onesided_loss_meets_its_outside_check(data_root: Path) -> None:
    records = run(replace(LABORATORY, device="1", calibration="1.0"), data_root, "nls-onesided")
    assert chosen(records, filter="kalman").rmse_m == pytest.approx(1.17, rel=0.1)


def test_the_grid_filter_meets_its_outside_check(data_root: Path) -> None:
    records = run(replace(LABORATORY, device="1", speed_prior=0.5), data_root, "bayes-grid")
    assert chosen(records, filter="own").rmse_m == pytest.approx(1.43, rel=0.1)


def test_a_method_that_is_a_filter_is_recorded_so_and_takes_the_speed_prior(data_root: Path) -> None:
    request = replace(SHORT, thin=20)
    slow, fast = (run(replace(request, speed_prior=speed), data_root, "bayes-grid") for speed in (0.5, 1.4))
    assert [record.filter for record in slow] == ["own", "kalman"]
    assert all(one.rmse_m != other.rmse_m for one, other in zip(slow, fast, strict=True))


@pytest.mark.parametrize("method", ["nls-onesided", "bayes-grid"])
def test_offline_only_what_a_smoother_made_is_recorded(method: str, data_root: Path) -> None:
    causal = chosen(run(replace(SHORT, thin=10), data_root, method), filter="kalman")
    (offline,) = run(replace(SHORT, thin=10, smoother=True), data_root, method)
    assert offline.filter == "kalman" and offline.smoother and not causal.smoother
    assert offline.rmse_m is not None and causal.rmse_m is not None and offline.rmse_m < causal.rmse_m
    assert offline.n == causal.n


def test_there_is_a_record_for_each_device_label_and_filter(data_root: Path) -> None:
    records = run(replace(LABORATORY, labels="both", thin=5), data_root, "trilateration")
    found = [(record.device, record.labels, record.filter) for record in records]
    kinds, filters = ("published", "repaired"), ("none", "kalman")
    assert found == [(device, kind, name) for device in (1, 2) for kind in kinds for name in filters]
    assert all(record.n + record.n_before_first_fix > 700 for record in records)
    assert all(record.artifact is None and record.commit == running_commit() for record in records)


def test_one_device_scores_as_it_does_beside_the_other(data_root: Path) -> None:
    request = replace(LABORATORY, thin=5)
    alone = run(replace(request, device="2"), data_root, "lls")
    beside = [record for record in run(request, data_root, "lls") if record.device == 2]
    assert [replace(one, ms_per_fix=0.0) for one in alone] == [replace(one, ms_per_fix=0.0) for one in beside]


def test_offsets_are_fitted_on_the_source_alone(data_root: Path) -> None:
    for request in (OFFICE, replace(MALL, calibration="source-los")):
        offsets = source_offsets(request, data_root)
        assert offsets.recordings == ("office/1/lab1", "office/1/lab2", "office/1/lab4")
        assert offsets.offset_m == pytest.approx(0.95, abs=0.15)
    assert source_offsets(replace(MALL, calibration="source-median"), data_root).offset_m > 2.0


def test_given_offsets_are_used_as_they_are(data_root: Path) -> None:
    fitted = run(replace(SHORT, calibration="2.4"), data_root)
    given = evaluate(geometric_method("nls"), SHORT, data_root, offsets=RangeOffsets("2.4", 2.4))
    assert [one.rmse_m for one in given] == [one.rmse_m for one in fitted]


def test_thinning_keeps_the_time_step(data_root: Path) -> None:
    whole, thin = (tracks_of(geometric_method("lls"), replace(SHORT, thin=k), data_root) for k in (1, 10))
    assert len(thin[0].t_s) == -(-len(whole[0].t_s) // 10)
    assert thin[0].t_s[-1] == whole[0].t_s[len(thin[0].t_s) - 1]


def test_a_faster_walker_is_filtered_less(data_root: Path) -> None:
    records = [
        chosen(run(replace(SHORT, speed_prior=speed), data_root, "lls"), filter="kalman")
        for speed in (0.5, 5.0)
    ]
    assert records[0].rmse_m != records[1].rmse_m
    assert [record.speed_prior for record in records] == [0.5, 5.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"site": "moon"}, "packed/moon"),
        ({"site": "office"}, "--site with --protocol zero-shot"),
        ({"protocol": "one-shot"}, "--protocol"),
        ({"device": "3"}, "--device"),
        ({"calibration": "lots"}, "--calibration"),
        ({"labels": "true"}, "--labels"),
        ({"speed_prior": 0.0}, "--speed-prior"),
        ({"speed_prior": float("nan")}, "--speed-prior"),
        ({"thin": 0}, "--thin"),
    ],
)
def test_an_unusable_option_is_named(change: dict[str, object], message: str, data_root: Path) -> None:
    with pytest.raises(FplocError, match=message):
        run(replace(MALL, **change), data_root)


def test_data_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"shopping-mall.*fploc data build"):
        run(MALL, tmp_path)


def test_labels_that_a_site_lacks_are_named(data_root: Path) -> None:
    (track,) = tracks_of(geometric_method("lls"), OFFICE, data_root)
    bare = replace(track.recording, published_m=track.recording.published_m * float("nan"))
    request = replace(OFFICE, labels="published")
    with pytest.raises(FplocError, match="--labels for office: found published"):
        records_of("lls", request, [replace(track, recording=bare)])
    both = records_of("lls", OFFICE, [replace(track, recording=bare)])
    assert {record.labels for record in both} == {"repaired"}
