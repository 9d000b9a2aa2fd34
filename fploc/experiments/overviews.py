"""Runs of the log that answer at a glance which method is best where: one experiment for each protocol."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fploc.evaluation.overview import LABELS, overview
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.run_log import RunLog

KIND = "overview"


def experiment_name(protocol: str, preset: str) -> str:
    """Return the name of the experiment that compares methods under a protocol."""
    return f"best where: {protocol}, {preset}"


def record_overviews(records: Sequence[TrackedRecord], preset: str, runs: Path) -> None:
    """Write one run for each method into the experiment of each protocol.

    A run is named by its method and holds one number for each site and device, so that the charts of the
    experiment compare all methods, a section for each site, and no filter need be typed.

    Args:
        records: Of the preset.
        preset: Its name.
        runs: Folder of the log.
    """
    data = "made-up" if any(one.made_up for one in records) else "public"
    for protocol, methods in overview(records).items():
        log = RunLog(runs, experiment_name(protocol, preset), note=_note(protocol, data))
        for name, numbers in methods.items():
            log.record(
                name,
                tags={"kind": KIND, "method": name, "protocol": protocol, "preset": preset, "data": data},
                parameters={"labels": LABELS, "method": name},
                metrics=numbers,
                figures={},
                folders={},
            )


def _note(protocol: str, data: str) -> str:
    warning = "**Made-up buildings, no real data.** " if data == "made-up" else ""
    return (
        f"{warning}{protocol}: {protocol_of(protocol).meaning}. RMSE in metres against {LABELS} labels, mean over "
        "seeds, behind the filter over time; smaller is better. Open the chart view: a section for each site, a bar "
        "for each method. Single runs, with settings, figures and models, are in the experiment `fploc`."
    )
