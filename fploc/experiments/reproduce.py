"""``make reproduce``: get data, train, evaluate, tabulate; resumes stage by stage."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from fploc.conf import read_conf
from fploc.datasets.packed import read_packed
from fploc.errors import FplocError
from fploc.evaluation.protocols import Targets, protocol_of
from fploc.evaluation.records import read_tracked_records
from fploc.evaluation.report import comparison_rows, headline_records
from fploc.evaluation.run_log import RunLog
from fploc.experiments.duration import announce_duration
from fploc.experiments.learning import GENERATOR, Learner
from fploc.experiments.overviews import record_overviews
from fploc.experiments.plan import (
    CALIBRATIONS,
    EQUIPMENT,
    LEARNED_METHODS,
    SEEN,
    Learning,
    Scoring,
    chosen_protocols,
    learnings,
    needed_sites,
    scorings,
    without_lonely,
)
from fploc.experiments.preset import Preset, read_preset
from fploc.experiments.registered_models import register_models
from fploc.experiments.reporting import FACTS, FIGURES, PAGE, RECORDS, Report
from fploc.experiments.scoring import PLANS
from fploc.experiments.stages import Stage, StageBook
from fploc.experiments.synthesize import MATCH, synthesize
from fploc.experiments.tracked_scoring import FIGURE_LABELS, ScoreFiles, TrackedScoring
from fploc.experiments.training import Loggers
from fploc.experiments.world import World, prepare_world
from fploc.joint_localizer import NAME as DEVICE_LINK
from fploc.methods.registry import RIVAL_PARTS

EXPERIMENT = "fploc"
STAGES = "stages"
TRAINING = "train--"


class Reproduction:
    """All stages of one preset.

    Args:
        preset: What to train and evaluate.
        world: What to do it on.
        protocols: Sites of each protocol, of those at hand.
        data_root: Folder of packed sites.
        runs: Folder of everything written.
    """

    def __init__(
        self,
        preset: Preset,
        world: World,
        protocols: Mapping[str, Sequence[str]],
        data_root: Path,
        runs: Path,
    ) -> None:
        self.preset = preset
        self.world = world
        self.protocols = protocols
        self.data_root = data_root
        self.runs = runs
        self.folder = runs / (f"{preset.name}-made-up" if world.made_up else preset.name)
        self.packed = {site: read_packed(data_root, site) for site in (world.source, *world.others)}
        self.offsets_file = self.folder / "calibration" / f"{world.source}.json"
        self.learner = Learner(
            preset, world.source, self.packed, data_root, runs, self.offsets_file, self.folder
        )
        self.log = RunLog(runs, EXPERIMENT)
        self.files = ScoreFiles(self.folder)
        self.scoring = TrackedScoring(
            preset, world, self.packed, self.learner, self.log, self.files, data_root, runs
        )

    @classmethod
    def on(
        cls, preset: Preset, world: World, targets: Sequence[str] | None, data_root: Path, runs: Path
    ) -> Reproduction:
        """Return the reproduction of a preset on what is there; ``targets`` as in ``reproduce``."""
        if world.made_up:
            targets = world.others
            preset = replace(preset, ablation_targets=tuple(world.others))
        there = [read_packed(data_root, name).site for name in (world.source, *world.others)]
        protocols = chosen_protocols(preset, world.source, targets, [one.name for one in there])
        return cls(preset, world, without_lonely(protocols, world.source, there), data_root, runs)

    def stages(self) -> list[Stage]:
        """Return every stage in order."""
        generators = [self._generator_stage(seed) for seed in self.preset.seeds]
        chains = [self._chain_stage(one) for one in self.learnings]
        scorings = [self._scoring_stage(one) for one in self.scorings()]
        maps = [self._synthesis_stage(site) for site in self._synthesized()]
        work = [self._calibration_stage(), *generators, *chains, *maps, *scorings]
        return [*work, self._report_stage([*maps, *scorings])]

    @cached_property
    def learnings(self) -> list[Learning]:
        """Every chain to train."""
        return list(learnings(self.preset, self.protocols, self.world.source))

    def scorings(self) -> list[Scoring]:
        """Return everything to score; the plan of another site only where that is packed."""
        everything = scorings(self.preset, self.protocols)
        return [one for one in everything if one.plan in PLANS or one.plan in self.packed]

    def _calibration_stage(self) -> Stage:
        return self._stage(
            self._calibration_name, "", [self.world.source], [self.offsets_file], (), self._calibrate
        )

    def _generator_stage(self, seed: int) -> Stage:
        source = self.world.source
        return self._stage(
            self._generator_name(seed),
            "",
            [source],
            [self.learner.folder_of(GENERATOR, Learning(SEEN, source, seed))],
            [self._calibration_name],
            lambda: self.learner.train_generator(seed, self._loggers(SEEN, source, seed, "")),
        )

    def _chain_stage(self, learning: Learning) -> Stage:
        loggers = self._loggers(learning.protocol, learning.target, learning.seed, learning.ablation)
        return self._stage(
            learning.name,
            learning.ablation,
            self.learner.sites_of(learning.protocol, learning.target),
            [self.learner.folder_of("gnn-fpdnn", learning)],
            [self._generator_name(learning.seed), *(one.name for one in self._needed(learning))],
            lambda: self.learner.learn(learning, loggers),
        )

    def _needed(self, learning: Learning) -> list[Learning]:
        """Return the chains that one goes on from or shares networks with."""
        protocol = protocol_of(learning.protocol, self.world.source)
        start = protocol.starts_from(learning.target)
        source = self.world.source
        needed = []
        if start is not None:
            target = source if start == SEEN else learning.target
            needed.append(replace(learning, protocol=start, target=target))
        if learning.ablation:
            needed.append(replace(learning, ablation=""))
        known = self.learnings
        return [one for one in needed if one in known]

    def _scoring_stage(self, scoring: Scoring) -> Stage:
        file = self.files.records(scoring)
        protocol = protocol_of(scoring.protocol, self.world.source)
        trained = Learning(protocol.trained_under, scoring.site, scoring.seed, scoring.ablation).name
        needed = trained if scoring.method in LEARNED_METHODS else self._calibration_name
        sites = self.learner.sites_of(scoring.protocol, scoring.site)
        lent = [scoring.plan] if scoring.plan in self.packed else []
        stage = self._stage(
            f"score--{scoring.name}",
            scoring.ablation,
            [*sites, *lent],
            [file],
            [needed],
            partial(self.scoring.score, scoring),
        )
        return replace(stage, inputs=[*stage.inputs, *self._scored_with(scoring)])

    def _scored_with(self, scoring: Scoring) -> list[str]:
        """Return what a score depends on beside networks and data."""
        preset = self.preset
        studied: Mapping[str, list[Any]] = {
            CALIBRATIONS: [preset.calibrations],
            EQUIPMENT: [preset.access_point_counts, preset.survey_errors_m],
        }
        settings = [*studied.get(scoring.study, []), self._method_settings.get(scoring.method)]
        if protocol_of(scoring.protocol, self.world.source).targets is Targets.LINKED:
            settings.append(read_conf("link", DEVICE_LINK))
        return [json.dumps(one, sort_keys=True) for one in settings]

    @cached_property
    def _method_settings(self) -> dict[str, dict[str, Any]]:
        """Settings of the methods that have some, by name; many stages share one, and each is a YAML file."""
        return {name: read_conf("method", name) for name in RIVAL_PARTS}

    def _synthesis_stage(self, site: str) -> Stage:
        return self._stage(
            f"synthesize--{site}",
            "",
            list(dict.fromkeys([self.world.source, site])),
            [self._match_file(site)],
            [self._generator_name(self.preset.seeds[0])],
            partial(self._synthesize, site),
        )

    def _report_stage(self, before: Sequence[Stage]) -> Stage:
        return Stage(
            name="report",
            inputs=[f"{stage.name} {stage.key}" for stage in before],
            outputs=[self.folder / name for name in (RECORDS, PAGE, FACTS, FIGURES)],
            after=[stage.name for stage in before],
            run=self._report,
        )

    def _stage(
        self,
        name: str,
        ablation: str,
        sites: Sequence[str],
        outputs: Sequence[Path],
        after: Sequence[str],
        run: Callable[[], None],
    ) -> Stage:
        hashes = [self.packed[site].manifest_hash for site in sites]
        return Stage(
            name=name, inputs=[self._fingerprints[ablation], *hashes], outputs=outputs, after=after, run=run
        )

    @cached_property
    def _fingerprints(self) -> dict[str, str]:
        """Fingerprint of the preset under each ablation; many stages share one, and each reads YAML."""
        return {name: self.preset.variant(name).fingerprint for name in ("", *self.preset.ablations)}

    @property
    def _calibration_name(self) -> str:
        return f"calibrate--{self.world.source}"

    @staticmethod
    def _generator_name(seed: int) -> str:
        return f"{TRAINING}generator--seed-{seed}"

    def _calibrate(self) -> None:
        self.offsets_file.parent.mkdir(parents=True, exist_ok=True)
        self.learner.source_data(None).fitted_offsets().save(self.offsets_file)

    def _loggers(self, protocol: str, site: str, seed: int, ablation: str) -> Loggers:
        tags = self.scoring.tags("training", Scoring("", protocol, site, seed, ablation))
        return lambda network: self.log.training_logger(f"train {network} · {protocol} · {site}", tags)

    def _synthesize(self, site: str) -> None:
        synthesize(
            site,
            source=self.world.source,
            preset_name=self.preset.name,
            seed=self.preset.seeds[0],
            data_root=self.data_root,
            runs=self.runs,
            out=self._match_file(site).parent,
        )

    def _report(self) -> None:
        book = StageBook(self.folder / STAGES)
        trained = [stage.name for stage in self.stages() if stage.name.startswith(TRAINING)]
        report = Report(
            self.preset,
            self.world.source,
            self.packed,
            self.scorings(),
            self.files,
            self.data_root,
            self.runs,
        )
        report.write(
            {name: book.cost(name) for name in trained},
            [self._match_file(site) for site in self._synthesized()],
        )
        record_overviews(read_tracked_records(self.folder / RECORDS), self.preset.name, self.runs)
        register_models(self.log, self.learner.folders_of(self.learnings), made_up=self.world.made_up)

    def _synthesized(self) -> list[str]:
        """Return the sites that the generator's maps are drawn of."""
        if self.world.made_up:
            return [self.world.source]
        return [site for site in self.preset.synthesized if site in self.packed]

    def _match_file(self, site: str) -> Path:
        return self.folder / "synthetic" / site / MATCH


@dataclass(frozen=True)
class Outcome:
    """What a reproduction ends in.

    Args:
        preset: Its name.
        made_up: True where all of it stands on made-up buildings.
        labels: Kind of labels that ``rows`` are measured against.
        rows: The comparison of methods, as printed.
        places: Where results, records, figures, artifacts and the run log lie.
    """

    preset: str
    made_up: bool
    labels: str
    rows: Sequence[Mapping[str, str]]
    places: Mapping[str, str]


def reproduce(
    preset_name: str,
    data_root: Path,
    source: Path | None,
    runs: Path,
    targets: Sequence[str] | None,
    workers: int,
) -> Outcome:
    """Run every stage of a preset that is not done yet.

    Args:
        preset_name: ``smoke``, ``default``, ``full``, ``published`` or ``paper``.
        data_root: Folder of the data.
        source: Local copy of the public files; None looks at FPLOC_SOURCE, the cache, then GitHub.
        runs: Folder of everything written.
        targets: Sites to test on instead of the preset's; None keeps these.
        workers: Processes that stages run in side by side; 1 runs them here one after the other.

    Returns:
        The comparison, and where everything lies.

    Raises:
        FplocError: For any bad input.
    """
    if workers < 1:
        raise FplocError(
            "--workers", value=workers, expected="1 or more", way_out="write the number of cores to use"
        )
    quieten()
    preset = read_preset(preset_name)
    world = prepare_world(data_root, source, needed_sites(preset, targets))
    reproduction = Reproduction.on(preset, world, targets, data_root, runs)
    book, stages = StageBook(reproduction.folder / STAGES), reproduction.stages()
    if any(stage.name.startswith(TRAINING) for stage in book.left(stages)):
        announce_duration(preset, reproduction.learner.source_data(None), reproduction.learnings)
    if workers == 1:
        book.run(stages)
    else:
        run_by_name = partial(run_stage, preset, world, targets, data_root, runs)
        book.run_side_by_side(stages, workers, run_by_name)
    tracked = read_tracked_records(reproduction.folder / RECORDS)
    return Outcome(
        preset=preset.name,
        made_up=world.made_up,
        labels=FIGURE_LABELS,
        rows=comparison_rows(headline_records(tracked), labels=FIGURE_LABELS),
        places={
            "results": str(reproduction.folder / PAGE),
            "records": str(reproduction.folder / RECORDS),
            "figures": str(reproduction.folder / FIGURES),
            "artifacts": str(reproduction.learner.artifacts / preset.name),
            "MLflow": reproduction.log.uri,
        },
    )


def run_stage(
    preset: Preset,
    world: World,
    targets: Sequence[str] | None,
    data_root: Path,
    runs: Path,
    name: str,
) -> None:
    """Run the stage ``name`` in this process; other arguments as ``reproduce``."""
    stages = _stages_by_name(preset, world, None if targets is None else tuple(targets), data_root, runs)
    stages[name].run()


def quieten() -> None:
    """Keep libraries from writing over the stages."""
    for chatty in ("lightning.pytorch", "mlflow", "alembic"):
        logging.getLogger(chatty).setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", module="lightning|torch|mlflow")


_OPENED: dict[str, dict[str, Stage]] = {}
"""Stages of the reproduction that this process works on: its data are read once."""


def _stages_by_name(
    preset: Preset, world: World, targets: tuple[str, ...] | None, data_root: Path, runs: Path
) -> dict[str, Stage]:
    key = repr((preset, world, targets, data_root, runs))
    if key not in _OPENED:
        quieten()
        opened = Reproduction.on(preset, world, targets, data_root, runs)
        _OPENED[key] = {stage.name: stage for stage in opened.stages()}
    return _OPENED[key]
