"""Result records: one line of JSON for each thing that was scored, and the source of every table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fploc.errors import BadFileError, MissingFileError
from fploc.files import whole

NO_FILTER, KALMAN, OWN = "none", "kalman", "own"
"""What a record is behind: nothing, the Kalman filter, or what the method is itself."""


@dataclass(frozen=True)
class Record:
    """One result, with the fields of design §8 in their order.

    Args:
        method: Name of the method.
        protocol: Name of the protocol.
        site: Target.
        device: 1 or 2.
        labels: ``published`` or ``repaired``.
        calibration: How range offsets were removed.
        plan: Which plan the method saw.
        speed_prior: Of the filter, metres per second.
        smoother: True for an offline smoother.
        thin: Every how many intervals one was kept.
        filter: ``none``, ``kalman`` or ``own``.
        preset: That trained the method.
        seed: Of the training.
        n: As all metrics down to ``nees``: ``fploc.evaluation.metrics.Scores``; None where undefined.
        ms_per_fix: Milliseconds per interval of the batch that was run.
        artifact: What was trained, as it names itself; None where nothing was.
        commit: Git revision of the code; None outside a checkout.
        condition: What else differs from what the protocol says, for example ``without link``; else empty.
    """

    method: str
    protocol: str
    site: str
    device: int
    labels: str
    calibration: str
    plan: str
    speed_prior: float
    smoother: bool
    thin: int
    filter: str
    preset: str
    seed: int
    n: int
    n_before_first_fix: int
    no_fix_share: float | None
    rmse_m: float | None
    rmse_fixed_m: float | None
    mae_m: float | None
    p50_m: float | None
    p90_m: float | None
    p95_m: float | None
    coverage95: float | None
    nees: float | None
    ms_per_fix: float
    artifact: str | None
    commit: str | None
    condition: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the record as plain JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class TrackedRecord:
    """A result record and what it came from.

    Args:
        record: The record.
        run_id: Of the MLflow run that holds it.
        data_hash: Over the packed sites of source and target.
        made_up: True where the buildings are made up.
    """

    record: Record
    run_id: str
    data_hash: str
    made_up: bool

    def as_json(self) -> dict[str, Any]:
        """Return one line of a records file: the record's fields, then the others."""
        return self.record.as_json() | {
            "run_id": self.run_id,
            "data_hash": self.data_hash,
            "made_up": self.made_up,
        }


def write_records(records: Iterable[Record | TrackedRecord], path: Path) -> None:
    """Write records as JSON lines, in one move."""
    with whole(path) as part:
        part.write_text("".join(json.dumps(one.as_json()) + "\n" for one in records), encoding="utf-8")


def tracked_record(line: str) -> TrackedRecord:
    """Return the record of one line of a records file.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: If the line holds none.
    """
    values = json.loads(line)
    own = {name: values.pop(name) for name in ("run_id", "data_hash", "made_up")}
    return TrackedRecord(Record(**values), **own)


def read_tracked_records(path: Path) -> list[TrackedRecord]:
    """Return the tracked records of a file that ``write_records`` wrote.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If a line is no such record.
    """
    if not path.is_file():
        raise MissingFileError(path, expected="result records", way_out="make them: fploc reproduce")
    records = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            records.append(tracked_record(line))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BadFileError(
                path,
                f"line {number}",
                value=f"{type(error).__name__} {error}",
                expected="a result record as JSON",
                way_out="make it again: fploc reproduce",
            ) from error
    return records


def finite_or_none(value: float) -> float | None:
    """Return a metric as records hold it: JSON knows no NaN."""
    return value if math.isfinite(value) else None
