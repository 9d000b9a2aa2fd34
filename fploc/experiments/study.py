"""What a preset varies around one method at one site: calibration, number of access points, their survey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fploc.datasets.packed import read_packed
from fploc.evaluation.conditions import CALIBRATION, condition
from fploc.evaluation.evaluate import REPAIRED, EvaluationRequest
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import Record
from fploc.evaluation.studies import Equipment
from fploc.experiments.scoring import ready_method, scored


def calibration_study(
    name: str, request: EvaluationRequest, calibrations: Sequence[str], data_root: Path, runs: Path
) -> list[Record]:
    """Return the records of a method behind each of several calibrations; errors as ``ready_method``."""
    return [
        replace(record, condition=condition(CALIBRATION, calibration))
        for calibration in calibrations
        for record in scored(name, request, calibration, data_root, runs).records
    ]


def equipment_study(
    name: str,
    request: EvaluationRequest,
    counts: Sequence[int],
    errors_m: Sequence[float],
    data_root: Path,
    runs: Path,
) -> list[Record]:
    """Return the records of a method with fewer access points, and with ones that stand elsewhere.

    They are scored by repaired labels alone.

    Args:
        name: Of the method.
        request: What is asked of it.
        counts: Numbers of access points.
        errors_m: Greatest errors of their coordinates, metres.
        data_root: Folder of packed sites.
        runs: Folder of runs.

    Raises:
        FplocError: As ``ready_method``.
    """
    ready = ready_method(name, request, None, data_root, runs)
    request = replace(request, calibration=ready.offsets.estimator, labels=REPAIRED)
    target = read_packed(data_root, request.site)
    recordings = protocol_of(request.protocol, request.source).testing(target, request.device)
    equipment = Equipment(
        name,
        ready.method,
        ready.offsets,
        target.site,
        [one.thinned(request.thin) for one in recordings],
        ready.artifact,
    )
    return [
        *equipment.as_is(request),
        *equipment.with_fewer(request, counts),
        *equipment.resurveyed(request, errors_m),
    ]
