"""Result records: one line of JSON for each thing that was scored, and the source of every table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from fploc.errors import BadFileError, MissingFileError
from fploc.files import whole


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


def write_records(records: Iterable[Record], path: Path) -> None:
    """Write records as JSON lines, in one move."""
    with whole(path) as part:
        part.write_text("".join(json.dumps(one.as_json()) + "\n" for one in records), encoding="utf-8")


def read_records(path: Path) -> list[Record]:
    """Read what ``write_records`` wrote.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If a line is no record.
    """
    if not path.is_file():
        raise MissingFileError(path, expected="result records", way_out="make them with `fploc reproduce`")
    lines = path.read_text(encoding="utf-8").splitlines()
    return [_parsed(line, path, number) for number, line in enumerate(lines, start=1)]


def finite_or_none(value: float) -> float | None:
    """Return a metric as records hold it: JSON knows no NaN."""
    return value if math.isfinite(value) else None


def _parsed(line: str, path: Path, number: int) -> Record:
    names = [one.name for one in fields(Record)]
    try:
        values = json.loads(line)
    except ValueError:
        values = None
    if not isinstance(values, Mapping) or sorted(values) != sorted(names):
        raise BadFileError(
            path,
            f"line {number}",
            value=repr(line[:60]),
            expected=f"a JSON object with {', '.join(names)}",
            way_out="delete the file and evaluate again",
        )
    return Record(**values)
