from __future__ import annotations

from dataclasses import replace

import pytest

from fploc.evaluation.overview import overview
from fploc.evaluation.records import Record, TrackedRecord

RECORD = Record(
    method="nls", protocol="zero-shot", site="mall", device=1, labels="repaired", calibration="none",
    plan="real", speed_prior=0.5, smoother=False, thin=1, filter="kalman", preset="full", seed=0, n=9,
    n_before_first_fix=0, no_fix_share=0.0, rmse_m=2.0, rmse_fixed_m=2.0, mae_m=1.0, p50_m=1.0, p90_m=3.0,
    p95_m=4.0, coverage95=0.9, nees=2.0, ms_per_fix=0.1, artifact=None, commit=None,
)  # fmt: skip


def tracked(*changes: dict[str, object]) -> list[TrackedRecord]:
    return [TrackedRecord(replace(RECORD, **one), "run", "hash", False) for one in changes]  # type: ignore[arg-type]


def test_a_method_is_a_line_of_its_errors_at_every_place() -> None:
    said = overview(
        tracked(
            {"rmse_m": 2.0},
            {"device": 2, "rmse_m": 4.0},
            {"method": "gnn", "rmse_m": 1.0},
            {"method": "gnn", "rmse_m": 3.0, "seed": 1},
            {"method": "gnn", "device": 2, "rmse_m": 5.0},
        )
    )
    assert said == {
        "zero-shot": {
            "nls": {"mall/device 1 rmse_m": 2.0, "mall/device 2 rmse_m": 4.0, "all sites/rmse_m": 3.0},
            "gnn": {"mall/device 1 rmse_m": 2.0, "mall/device 2 rmse_m": 5.0, "all sites/rmse_m": 3.5},
        }
    }


def test_the_mean_is_over_places_that_all_methods_share() -> None:
    (methods,) = overview(
        tracked({"rmse_m": 2.0}, {"site": "hall", "rmse_m": 9.0}, {"method": "gnn", "rmse_m": 1.0})
    ).values()
    assert methods["nls"]["all sites/rmse_m"] == 2.0 and methods["gnn"]["all sites/rmse_m"] == 1.0
    (apart,) = overview(tracked({}, {"method": "gnn", "site": "hall"})).values()
    assert not any("all sites" in name for own in apart.values() for name in own)


@pytest.mark.parametrize(
    "change",
    [
        {"labels": "published"},
        {"filter": "none"},
        {"plan": "blank"},
        {"preset": "full--linear-solver"},
        {"condition": "without link"},
        {"thin": 10},
    ],
    ids=str,
)
def test_what_is_no_headline_is_left_out(change: dict[str, object]) -> None:
    assert overview(tracked({}, {"rmse_m": 99.0, **change})) == overview(tracked({}))


def test_a_method_with_a_filter_of_its_own_is_shown_by_it() -> None:
    (methods,) = overview(tracked({"rmse_m": 9.0}, {"filter": "own", "rmse_m": 1.0})).values()
    assert methods["nls"]["mall/device 1 rmse_m"] == 1.0
