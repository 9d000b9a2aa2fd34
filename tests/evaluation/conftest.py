"""Records that differ from a plain one in what a test names."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from fploc.evaluation.records import Record, TrackedRecord

PLAIN: dict[str, object] = {
    "method": "gnn-fpdnn", "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "labels": "repaired",
    "calibration": "source-los", "plan": "real", "speed_prior": 0.5, "smoother": False, "thin": 1,
    "filter": "kalman", "preset": "full", "seed": 0, "n": 100, "n_before_first_fix": 0, "no_fix_share": 0.0,
    "rmse_m": 1.0, "rmse_fixed_m": 1.0, "mae_m": 0.9, "p50_m": 0.8, "p90_m": 1.6, "p95_m": 2.0,
    "coverage95": 0.9, "nees": 2.0, "ms_per_fix": 0.5, "artifact": None, "commit": "abc",
}  # fmt: skip

MakeRecord = Callable[..., TrackedRecord]


@pytest.fixture(scope="session")
def made() -> MakeRecord:
    """Return what makes a record: of zero-shot gnn-fpdnn with KF in the mall, but for what is named."""

    def made(rmse_m: float | None = 1.0, *, made_up: bool = False, **changes: object) -> TrackedRecord:
        values = PLAIN | {"rmse_m": rmse_m} | changes
        return TrackedRecord(Record(**values), "run", "hash", made_up)  # type: ignore[arg-type]

    return made
