"""``make reproduce``: get data, train, evaluate, tabulate; resumes stage by stage."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datamodules.measured import MeasuredDataModule
from fploc.artifacts import Artifact, ArtifactKey, load_artifact
from fploc.datasets.packed import PackedSite, read_packed
from fploc.evaluation.error_series import (
    error_series,
    pooled_errors_m,
    read_error_series,
    write_error_series,
)
from fploc.evaluation.evaluate import EvaluationRequest, records_of, tracks_of
from fploc.evaluation.metrics import held_errors_m
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import Record, TrackedRecord, read_tracked_records, write_records
from fploc.evaluation.report import Scoring, comparison_rows, page
from fploc.evaluation.revision import running_commit
from fploc.evaluation.run_log import RunLog
from fploc.experiments.duration import announce_duration
from fploc.experiments.preset import Preset, read_preset
from fploc.experiments.scoring import (
    LEARNED_METHODS,
    artifacts_folder,
    data_hash,
    ready_method,
    reproduce_command,
)
from fploc.experiments.stages import Stage, StageBook
from fploc.experiments.training import (
    Loggers,
    chain_artifacts,
    fit_dropout,
    synthetic_data,
    train_chain,
    train_generator,
    trained_from,
    virtual_site,
)
from fploc.experiments.world import World, prepare_world
from fploc.files import whole
from fploc.localizer import Track
from fploc.models.generator import Generator
from fploc.plots.results import plot_cdf, plot_tracks
from fploc.progress import print_table
from fploc.virtual.dropout import Dropout

EXPERIMENT = "fploc"
TRAINING = "train--"
FIGURE_LABELS = "repaired"


class Reproduction:
    """All stages of one preset.

    Args:
        preset: What to train and evaluate.
        world: What to do it on.
        data_root: Folder of packed sites.
        runs: Folder of everything written.
    """

    def __init__(self, preset: Preset, world: World, data_root: Path, runs: Path) -> None:
        self.preset = preset
        self.world = world
        self.data_root = data_root
        self.runs = runs
        self.folder = runs / (f"{preset.name}-made-up" if world.made_up else preset.name)
        self.artifacts = artifacts_folder(runs)
        self.packed = {site: read_packed(data_root, site) for site in (world.source, *world.targets)}
        self.offsets_file = self.folder / "calibration" / f"{world.source}.json"
        self.log = RunLog(runs, EXPERIMENT)

    def stages(self) -> list[Stage]:
        """Return every stage in order."""
        trainings = [stage for seed in self.preset.seeds for stage in self._training_stages(seed)]
        scorings = [self._scoring_stage(scoring) for scoring in self._scorings()]
        return [self._calibration_stage(), *trainings, *scorings, self._report_stage(scorings)]

    def source_data(self, offsets_file: Path | None) -> MeasuredDataModule:
        """Return the source's recordings, ready; offsets are fitted anew where no file is given."""
        measured = MeasuredDataModule(
            data_root=self.data_root,
            site=self.world.source,
            calibration=self.preset.calibration,
            labels=self.preset.labels,
            batch_size=self.preset.batch_intervals,
            batches=self.preset.batches_per_epoch,
            offsets_file=offsets_file,
        )
        measured.setup()
        return measured

    @cached_property
    def measured(self) -> MeasuredDataModule:
        """The source's recordings behind the offsets that the calibration stage has saved."""
        return self.source_data(self.offsets_file)

    def _calibration_stage(self) -> Stage:
        source = self.world.source
        return self._stage(self._calibration_name, [source], [self.offsets_file], (), self._calibrate)

    @property
    def _calibration_name(self) -> str:
        return f"calibrate--{self.world.source}"

    @staticmethod
    def _training_name(what: str, seed: int) -> str:
        return f"{TRAINING}{what}--seed-{seed}"

    def _training_stages(self, seed: int) -> Iterator[Stage]:
        source = self.world.source
        generator, chain = self._training_name("generator", seed), self._training_name(source, seed)
        yield self._stage(
            generator,
            [source],
            [self._key("generator", "seen", source, seed).folder(self.artifacts)],
            [self._calibration_name],
            partial(self._train_generator, seed),
        )
        yield self._stage(
            chain,
            [source],
            [self._key("gnn-fpdnn", "seen", source, seed).folder(self.artifacts)],
            [generator],
            partial(self._train, source, "seen", seed),
        )
        for target in self.world.targets:
            yield self._stage(
                self._training_name(target, seed),
                [source, target],
                [self._key("gnn-fpdnn", "zero-shot", target, seed).folder(self.artifacts)],
                [chain],
                partial(self._train, target, "zero-shot", seed),
            )

    def _scorings(self) -> Iterator[Scoring]:
        places = [("seen", self.world.source), *(("zero-shot", target) for target in self.world.targets)]
        for protocol, site in places:
            for method in self.preset.methods:
                seeds = self.preset.seeds if method in LEARNED_METHODS else self.preset.seeds[:1]
                for seed in seeds:
                    yield Scoring(method, protocol, site, seed)

    def _scoring_stage(self, scoring: Scoring) -> Stage:
        learned = scoring.method in LEARNED_METHODS
        trained = self._training_name(scoring.site, scoring.seed)
        return self._stage(
            f"score--{scoring.name}",
            [self.world.source, scoring.site],
            [self._records_file(scoring), self._records_file(scoring).with_suffix(".npz")],
            [trained if learned else self._calibration_name],
            partial(self._score, scoring),
        )

    def _report_stage(self, scorings: Sequence[Stage]) -> Stage:
        return Stage(
            name="report",
            inputs=[f"{stage.name} {stage.key}" for stage in scorings],
            outputs=[self.folder / name for name in ("records.jsonl", "results.md", "figures")],
            after=[stage.name for stage in scorings],
            run=self._report,
        )

    def _stage(
        self,
        name: str,
        sites: Sequence[str],
        outputs: Sequence[Path],
        after: Sequence[str],
        run: Callable[[], None],
    ) -> Stage:
        hashes = [self.packed[site].manifest_hash for site in sites]
        inputs = [self.preset.fingerprint, *hashes]
        return Stage(name=name, inputs=inputs, outputs=outputs, after=after, run=run)

    def _key(self, method: str, protocol: str, target: str, seed: int) -> ArtifactKey:
        return ArtifactKey(method, protocol, target, self.preset.name, seed)

    def _load(self, method: str, protocol: str, target: str, seed: int) -> Artifact:
        return load_artifact(
            self.artifacts,
            self._key(method, protocol, target, seed),
            data_hash=self._data_hash(target),
            command=reproduce_command(self.preset.name, target),
        )

    def _data_hash(self, target: str) -> str:
        return data_hash(self.packed[self.world.source], self.packed[target])

    def _calibrate(self) -> None:
        self.offsets_file.parent.mkdir(parents=True, exist_ok=True)
        self.source_data(None).fitted_offsets().save(self.offsets_file)

    def _train_generator(self, seed: int) -> None:
        source = self.world.source
        generator, metrics = train_generator(
            self.preset, self.measured, seed, loggers=self._loggers("seen", source, seed), folder=self.folder
        )
        recordings = self.measured.recordings("train")
        dropout = fit_dropout(recordings, self.packed[source].site, self.preset.labels)
        Artifact(
            key=self._key("generator", "seen", source, seed),
            specs={"generator": self.preset.network_specs["generator"]},
            networks={"generator": generator},
            constants={"heard_shares": list(dropout.heard_shares), "validation": metrics},
            data_hash=self._data_hash(source),
            recordings=tuple(f"{one.site}/{one.name}" for one in recordings),
            command=reproduce_command(self.preset.name, source),
        ).save(self.artifacts)

    def _train(self, target: str, protocol: str, seed: int) -> None:
        artifact = self._load("generator", "seen", self.world.source, seed)
        generator = artifact.networks["generator"]
        assert isinstance(generator, Generator)
        dropout = Dropout(tuple(artifact.constants["heard_shares"]))
        start = (
            None
            if protocol == "seen"
            else trained_from(self._load("gnn-fpdnn", "seen", self.world.source, seed))
        )
        trained = train_chain(
            self.preset,
            self.measured,
            synthetic_data(
                virtual_site(self.packed[target], generator, dropout, self.preset), self.preset, seed
            ),
            seed,
            start=start,
            loggers=self._loggers(protocol, target, seed),
            folder=self.folder,
        )
        for made in chain_artifacts(
            trained,
            self.preset,
            self.measured,
            protocol=protocol,
            target=target,
            seed=seed,
            data_hash=self._data_hash(target),
            command=reproduce_command(self.preset.name, target),
        ):
            made.save(self.artifacts)

    def _loggers(self, protocol: str, site: str, seed: int) -> Loggers:
        tags = self._tags("training", protocol, site, seed)
        return lambda network: self.log.training_logger(f"train {network} · {protocol} · {site}", tags)

    def _score(self, scoring: Scoring) -> None:
        request = EvaluationRequest(
            protocol=scoring.protocol,
            site=scoring.site,
            source=self.world.source,
            calibration=self.preset.calibration,
            thin=self.preset.thin,
            preset=self.preset.name,
            seed=scoring.seed,
        )
        ready = ready_method(scoring.method, request, None, self.data_root, self.runs)
        tracks = tracks_of(ready.method, request, self.data_root, offsets=ready.offsets)
        scored = replace(request, calibration=ready.offsets.estimator)
        records = records_of(scoring.method, scored, tracks, artifact=ready.artifact)
        run_id = self._record_run(scoring, records, tracks)
        file = self._records_file(scoring)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_error_series([error_series(track, FIGURE_LABELS) for track in tracks], file.with_suffix(".npz"))
        tracked = [
            TrackedRecord(record, run_id, self._data_hash(scoring.site), self.world.made_up)
            for record in records
        ]
        write_records(tracked, file)

    def _record_run(self, scoring: Scoring, records: Sequence[Record], tracks: Sequence[Track]) -> str:
        kind = (
            protocol_of(scoring.protocol, self.world.source).kind
            if scoring.method in LEARNED_METHODS
            else "baseline"
        )
        packed = self.packed[scoring.site]
        metrics = {
            f"device{record.device}.{record.labels}.{record.filter}.{name}": value
            for record in records
            for name, value in asdict(record).items()
            if isinstance(value, float) and name not in ("speed_prior",)
        }
        figures = {
            f"cdf-device{device}.png": plot_cdf(
                _errors_by_filter([track for track in tracks if track.recording.device == device]),
                f"{scoring.method}, {scoring.site}, device {device}",
                made_up=self.world.made_up,
            )
            for device in sorted({record.device for record in records})
        }
        figures |= {
            f"track-device{track.recording.device}.png": _track_figure(track, packed, scoring.method)
            for track in _first_of_each_device(tracks)
        }
        folders = {}
        if scoring.method in LEARNED_METHODS:
            key = self._key(scoring.method, scoring.protocol, scoring.site, scoring.seed)
            folders["model"] = key.folder(self.artifacts)
        return self.log.record(
            f"{scoring.method} · {scoring.protocol} · {scoring.site}",
            tags=self._tags(kind, scoring.protocol, scoring.site, scoring.seed) | {"method": scoring.method},
            parameters={
                "method": scoring.method,
                "protocol": scoring.protocol,
                "site": scoring.site,
                "seed": scoring.seed,
                "preset": self.preset.name,
                "thin": self.preset.thin,
                "calibration": records[0].calibration,
                "speed_prior_mps": records[0].speed_prior,
                "data_hash": self._data_hash(scoring.site),
            },
            metrics=metrics,
            figures=figures,
            folders=folders,
        )

    def _report(self) -> None:
        scorings = list(self._scorings())
        files = [self._records_file(scoring) for scoring in scorings]
        tracked = [record for file in files for record in read_tracked_records(file)]
        figures = self.folder / "figures"
        figures.mkdir(parents=True, exist_ok=True)
        for protocol, site in dict.fromkeys((one.protocol, one.site) for one in scorings):
            there = [one for one in scorings if (one.protocol, one.site) == (protocol, site)]
            errors = {
                one.method: read_error_series(self._records_file(one).with_suffix(".npz"))
                for one in there
                if one.seed == self.preset.seeds[0]
            }
            for device in sorted({one.device for series in errors.values() for one in series}):
                figure = plot_cdf(
                    {
                        method: pooled_errors_m(series, device, filtered=True)
                        for method, series in errors.items()
                    },
                    f"{protocol}, {site}, device {device}, Kalman filter, {FIGURE_LABELS} labels",
                    made_up=self.world.made_up,
                )
                figure.savefig(figures / f"cdf--{protocol}--{site}--device{device}.png", dpi=120)
        with whole(self.folder / "records.jsonl") as part:
            part.write_text("".join(file.read_text() for file in files))
        with whole(self.folder / "results.md") as part:
            part.write_text(page(tracked, preset=self.preset.name))

    def _records_file(self, scoring: Scoring) -> Path:
        return self.folder / "scores" / f"{scoring.name}.jsonl"

    def _tags(self, kind: str, protocol: str, target: str, seed: int) -> dict[str, str]:
        return {
            "kind": kind,
            "protocol": protocol,
            "site": target,
            "seed": str(seed),
            "preset": self.preset.name,
            "data": "made-up" if self.world.made_up else "public",
            "data_hash": self._data_hash(target),
            "commit": running_commit() or "unknown",
        }


def reproduce(
    preset_name: str, data_root: Path, source: Path | None, runs: Path, targets: Sequence[str] | None
) -> None:
    """Run every stage of a preset that is not done yet, print the comparison and where everything lies.

    Args:
        preset_name: ``smoke``, ``default``, ``full`` or ``paper``.
        data_root: Folder of the data.
        source: Local copy of the public files; None looks at FPLOC_SOURCE, the cache, then GitHub.
        runs: Folder of everything written.
        targets: Sites to test on instead of the preset's; None keeps these.

    Raises:
        FplocError: For any bad input.
    """
    for chatty in ("lightning.pytorch", "mlflow", "alembic"):
        logging.getLogger(chatty).setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", module="lightning|torch|mlflow")
    preset = read_preset(preset_name)
    world = prepare_world(data_root, source, preset.targets if targets is None else targets)
    reproduction = Reproduction(preset, world, data_root, runs)
    book, stages = StageBook(reproduction.folder / "stages"), reproduction.stages()
    if not all(book.is_done(stage) for stage in stages if stage.name.startswith(TRAINING)):
        announce_duration(preset, reproduction.source_data(None), len(world.targets))
    book.run(stages)
    tracked = read_tracked_records(reproduction.folder / "records.jsonl")
    title = "MADE-UP BUILDINGS, no real data" if world.made_up else "public data"
    print(f"\nPreset {preset.name}, {title}, {FIGURE_LABELS} labels, metres:")  # noqa: T201
    print_table(comparison_rows(tracked, labels=FIGURE_LABELS))
    for name, path in {
        "results": reproduction.folder / "results.md",
        "records": reproduction.folder / "records.jsonl",
        "figures": reproduction.folder / "figures",
        "artifacts": reproduction.artifacts / preset.name,
        "MLflow": f"{reproduction.log.uri} (look at it with `make ui`)",
    }.items():
        print(f"{name:>10}: {path}")  # noqa: T201
    sys.stdout.flush()


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
