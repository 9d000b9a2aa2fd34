"""What becomes of a scoring: records, the errors of its intervals, and a run that MLflow shows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.datasets.packed import PackedSite
from fploc.evaluation.error_series import error_series, write_error_series
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.metrics import held_errors_m
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import TrackedRecord, write_records
from fploc.evaluation.revision import running_commit
from fploc.evaluation.run_log import RunLog
from fploc.experiments.learning import Learner
from fploc.experiments.plan import (
    CALIBRATIONS,
    EQUIPMENT,
    LEARNED_METHODS,
    Learning,
    Scoring,
    is_headline,
)
from fploc.experiments.preset import Preset
from fploc.experiments.scoring import Scored, scored
from fploc.experiments.study import calibration_study, equipment_study
from fploc.experiments.world import World
from fploc.localizer import Track
from fploc.plots.results import plot_cdf, plot_tracks

FIGURE_LABELS = "repaired"


@dataclass(frozen=True)
class ScoreFiles:
    """Where what was scored lies.

    Args:
        folder: Of the preset.
    """

    folder: Path

    def records(self, scoring: Scoring) -> Path:
        """Return the file of its records."""
        return self.folder / "scores" / f"{scoring.name}.jsonl"

    def errors(self, scoring: Scoring) -> Path:
        """Return the file of the errors of its intervals."""
        return self.records(scoring).with_suffix(".npz")


class TrackedScoring:
    """Scores methods as a preset says, and logs it.

    Args:
        preset: What to evaluate.
        world: What to do it on.
        packed: All packed sites at hand, by name.
        learner: Knows what was trained, and on which data.
        log: Takes the runs.
        files: Where scores go.
        data_root: Folder of packed sites.
        runs: Folder of runs.
    """

    def __init__(
        self,
        preset: Preset,
        world: World,
        packed: Mapping[str, PackedSite],
        learner: Learner,
        log: RunLog,
        files: ScoreFiles,
        data_root: Path,
        runs: Path,
    ) -> None:
        self.preset = preset
        self.world = world
        self.packed = packed
        self.learner = learner
        self.log = log
        self.files = files
        self.data_root = data_root
        self.runs = runs

    def score(self, scoring: Scoring) -> None:
        """Score a method, log the run, and write errors and records; records come last.

        Raises:
            FplocError: If the method cannot be had, for example because nothing was trained.
        """
        request = EvaluationRequest(
            protocol=scoring.protocol,
            site=scoring.site,
            source=self.world.source,
            calibration=self.preset.calibration,
            plan=scoring.plan,
            thin=scoring.thin,
            preset=self.preset.variant(scoring.ablation).name,
            seed=scoring.seed,
        )
        done = self._scored(scoring, request)
        run_id = self._record_run(scoring, done)
        file = self.files.records(scoring)
        file.parent.mkdir(parents=True, exist_ok=True)
        if done.tracks:
            series = [error_series(track, FIGURE_LABELS) for track in done.tracks]
            write_error_series(series, self.files.errors(scoring))
        hashed = self._data_hash(scoring)
        tracked = [TrackedRecord(record, run_id, hashed, self.world.made_up) for record in done.records]
        write_records(tracked, file)

    def tags(self, kind: str, scoring: Scoring) -> dict[str, str]:
        """Return what runs can be searched by.

        Args:
            kind: Of the run, for example ``training``, ``baseline`` or ``zero-shot``.
            scoring: What it is about; a training's has no method.
        """
        return {
            "kind": kind,
            "protocol": scoring.protocol,
            "site": scoring.site,
            "seed": str(scoring.seed),
            "plan": scoring.plan,
            "thin": str(scoring.thin),
            "study": scoring.study or "none",
            "preset": self.preset.variant(scoring.ablation).name,
            "data": "made-up" if self.world.made_up else "public",
            "data_hash": self._data_hash(scoring),
            "commit": running_commit() or "unknown",
        }

    def _scored(self, scoring: Scoring, request: EvaluationRequest) -> Scored:
        method, preset, folders = scoring.method, self.preset, (self.data_root, self.runs)
        if scoring.study == CALIBRATIONS:
            return Scored(calibration_study(method, request, preset.calibrations, *folders), tracks=[])
        if scoring.study == EQUIPMENT:
            counts, errors_m = preset.access_point_counts, preset.survey_errors_m
            return Scored(equipment_study(method, request, counts, errors_m, *folders), tracks=[])
        return scored(method, request, None, *folders)

    def _record_run(self, scoring: Scoring, done: Scored) -> str:
        learned = scoring.method in LEARNED_METHODS
        protocol = protocol_of(scoring.protocol, self.world.source)
        kind = protocol.kind if learned else "baseline"
        metrics = {
            f"{_prefix(record.condition)}device{record.device}.{record.labels}.{record.filter}.{name}": value
            for record in done.records
            for name, value in asdict(record).items()
            if isinstance(value, float) and name not in ("speed_prior",)
        }
        artifact = Learning(protocol.trained_under, scoring.site, scoring.seed, scoring.ablation)
        return self.log.record(
            " · ".join(filter(None, [scoring.method, scoring.protocol, scoring.site, scoring.study])),
            tags=self.tags(kind, scoring) | {"method": scoring.method},
            parameters=asdict(scoring)
            | {
                "preset": self.preset.name,
                "calibration": done.records[0].calibration,
                "speed_prior_mps": done.records[0].speed_prior,
                "data_hash": self._data_hash(scoring),
            },
            metrics=metrics,
            figures=self._run_figures(scoring, done.tracks),
            folders={"model": self.learner.folder_of(scoring.method, artifact)} if learned else {},
        )

    def _run_figures(self, scoring: Scoring, tracks: Sequence[Track]) -> dict[str, Figure]:
        """Return the figures of a run: errors and one track of each device; none beside the plain ones."""
        if not is_headline(scoring, self.preset):
            return {}
        packed = self.packed[scoring.site]
        errors = {
            f"cdf-device{device}.png": plot_cdf(
                _errors_by_filter([track for track in tracks if track.recording.device == device]),
                f"{scoring.method}, {scoring.site}, device {device}",
                made_up=self.world.made_up,
            )
            for device in sorted({track.recording.device for track in tracks})
        }
        return errors | {
            f"track-device{track.recording.device}.png": _track_figure(track, packed, scoring.method)
            for track in _first_of_each_device(tracks)
        }

    def _data_hash(self, scoring: Scoring) -> str:
        return self.learner.data_hash(Learning(scoring.protocol, scoring.site, scoring.seed))


def _prefix(condition: str) -> str:
    """Return what stands before the metrics of a condition; nothing without one."""
    return f"{re.sub('[^a-z0-9.]+', '-', condition.lower())}." if condition else ""


def _errors_by_filter(tracks: Sequence[Track]) -> dict[str, NDArray[np.float64]]:
    def errors(filtered: bool) -> NDArray[np.float64]:
        return np.concatenate(
            [
                held_errors_m(
                    track.filtered if filtered and track.filtered is not None else track.unfiltered,
                    track.recording.labels_m(FIGURE_LABELS),
                )
                for track in tracks
            ]
        )

    return {"unfiltered": errors(False), "Kalman filter": errors(True)}


def _first_of_each_device(tracks: Sequence[Track]) -> list[Track]:
    return list({track.recording.device: track for track in reversed(tracks)}.values())[::-1]


def _track_figure(track: Track, packed: PackedSite, method: str) -> Figure:
    paths = {"unfiltered": track.unfiltered.positions_m}
    if track.filtered is not None:
        paths["Kalman filter"] = track.filtered.positions_m
    return plot_tracks(
        packed.plan,
        packed.site,
        track.recording.labels_m(FIGURE_LABELS),
        paths,
        f"{method}, {packed.site.name} {track.recording.name}",
    )
