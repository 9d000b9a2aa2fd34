"""Trains what a preset asks for: puts together what each chain learns from, and keeps what it has learned."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path

from datamodules.first_part import FirstPartDataModule
from datamodules.measured import MeasuredDataModule
from datamodules.pooled import PooledDataModule
from datamodules.synthetic import SyntheticDataModule
from fploc.artifacts import Artifact, ArtifactKey, load_artifact, offsets_of
from fploc.datasets.packed import PackedSite
from fploc.datasets.recordings import Recording
from fploc.evaluation.protocols import Tested, protocol_of, validation_site
from fploc.experiments.plan import LEARNED_METHODS, SEEN, Learning
from fploc.experiments.preset import Preset
from fploc.experiments.scoring import artifacts_folder, data_hash, reproduce_command
from fploc.experiments.training import (
    Loggers,
    Trained,
    TrainingData,
    chain_artifacts,
    fit_dropout,
    synthetic_data,
    train_chain,
    train_generator,
    trained_from,
    virtual_site,
)
from fploc.models.generator import Generator
from fploc.virtual.dropout import Dropout

GENERATOR = "generator"


class Learner:
    """Trains generator and chains of one preset and writes their artifacts.

    Args:
        preset: Sizes of the trainings.
        source: Site that zero-shot methods learn on.
        packed: All packed sites at hand, by name.
        data_root: Folder of packed sites.
        runs: Folder of runs.
        offsets_file: Range offsets of the source.
        folder: Lightning's working folder.
    """

    def __init__(
        self,
        preset: Preset,
        source: str,
        packed: Mapping[str, PackedSite],
        data_root: Path,
        runs: Path,
        offsets_file: Path,
        folder: Path,
    ) -> None:
        self.preset = preset
        self.source = source
        self.packed = packed
        self.data_root = data_root
        self.artifacts = artifacts_folder(runs)
        self.offsets_file = offsets_file
        self.folder = folder
        self._drawn: dict[tuple[str, int], SyntheticDataModule] = {}

    def source_data(self, offsets_file: Path | None) -> MeasuredDataModule:
        """Return the source's recordings, ready; offsets are fitted anew where no file is given."""
        measured = MeasuredDataModule(
            data_root=self.data_root,
            site=self.source,
            calibration=self.preset.calibration,
            labels=self.preset.labels,
            batch_size=self.preset.batch_intervals,
            batches=self.preset.batches_per_epoch,
            offsets_file=offsets_file,
            validation_thin=self.preset.validation_thin,
        )
        measured.setup()
        return measured

    def train_generator(self, seed: int, loggers: Loggers) -> None:
        """Train the generator on the source's recordings."""
        self._drawn.clear()
        generator, metrics = train_generator(
            self.preset, self.measured, seed, loggers=loggers, folder=self.folder
        )
        recordings = self.measured.recordings("train")
        dropout = fit_dropout(recordings, self.packed[self.source].site, self.preset.labels)
        Artifact(
            key=self._key(GENERATOR, Learning(SEEN, self.source, seed)),
            specs={GENERATOR: self.preset.network_specs[GENERATOR]},
            networks={GENERATOR: generator},
            constants={"heard_shares": list(dropout.heard_shares), "validation": metrics},
            data_hash=self.data_hash(Learning(SEEN, self.source, seed)),
            recordings=_names(recordings),
            command=reproduce_command(self.preset.name, self.source),
        ).save(self.artifacts)

    def learn(self, learning: Learning, loggers: Loggers) -> None:
        """Train the chain of ``learning``, or take over what does not differ from a chain without its change."""
        preset = self.preset.variant(learning.ablation)
        start = self._start(learning, preset)
        data = self._data(learning, preset, start)
        trained = self._taken_over(learning, preset, start)
        if trained is None:
            trained = train_chain(
                preset,
                data,
                learning.seed,
                start=None if start is None else trained_from(start),
                coarse=self._coarse(learning, preset),
                loggers=loggers,
                folder=self.folder,
            )
        for made in chain_artifacts(
            trained,
            preset,
            data,
            protocol=learning.protocol,
            target=learning.target,
            seed=learning.seed,
            data_hash=self.data_hash(learning),
            command=reproduce_command(self.preset.name, learning.target),
        ):
            made.save(self.artifacts)

    def folder_of(self, method: str, learning: Learning) -> Path:
        """Return where the artifact of a method lies."""
        return self._key(method, learning).folder(self.artifacts)

    def folders_of(self, learnings: Iterable[Learning]) -> dict[ArtifactKey, Path]:
        """Return where the artifacts of these chains lie, and those of their generators, as far as they are there."""
        keys = [self._key(method, one) for one in learnings for method in LEARNED_METHODS]
        keys += [self._key(GENERATOR, Learning(SEEN, self.source, seed)) for seed in self.preset.seeds]
        folders = {key: key.folder(self.artifacts) for key in keys}
        return {key: folder for key, folder in folders.items() if folder.is_dir()}

    def data_hash(self, learning: Learning) -> str:
        """Return the hash of the data that a chain depends on."""
        return data_hash(*(self.packed[site] for site in self.sites_of(learning.protocol, learning.target)))

    def sites_of(self, protocol: str, target: str) -> list[str]:
        """Return the sites that a protocol learns from for a target, then the target."""
        known = [one.site for one in self.packed.values()]
        sources = protocol_of(protocol, self.source).sources(self.packed[target].site, known)
        return list(dict.fromkeys([*sources, target]))

    @cached_property
    def measured(self) -> MeasuredDataModule:
        """The source's recordings behind the offsets that were saved."""
        return self.source_data(self.offsets_file)

    def _start(self, learning: Learning, preset: Preset) -> Artifact | None:
        """Return the chain that a training goes on from; None for a new one."""
        protocol = protocol_of(learning.protocol, self.source).starts_from(learning.target)
        if protocol is None or preset.streams == "virtual":
            return None
        target = self.source if protocol == SEEN else learning.target
        return self._load("gnn-fpdnn", Learning(protocol, target, learning.seed, learning.ablation))

    def _taken_over(self, learning: Learning, preset: Preset, start: Artifact | None) -> Trained | None:
        """Return what needs no training: without virtual intervals, a zero-shot target teaches nothing."""
        protocol = protocol_of(learning.protocol, self.source)
        measured_elsewhere = protocol.pools or protocol.tested is Tested.SECOND_PART
        if preset.streams == "measured" and start is not None and not measured_elsewhere:
            return trained_from(start)
        if learning.ablation and preset.trains_like(self.preset):
            return trained_from(self._load("gnn-fpdnn", self._unchanged(learning)))
        return None

    def _coarse(self, learning: Learning, preset: Preset) -> Trained | None:
        """Return the chain whose GNN an ablation of FPDNN alone shares."""
        shared = (
            preset.network_specs["gnn"] == self.preset.network_specs["gnn"]
            and preset.streams == self.preset.streams
        )
        if not (learning.ablation and shared):
            return None
        return trained_from(self._load("gnn-fpdnn", self._unchanged(learning)))

    @staticmethod
    def _unchanged(learning: Learning) -> Learning:
        return Learning(learning.protocol, learning.target, learning.seed)

    def _data(self, learning: Learning, preset: Preset, start: Artifact | None) -> TrainingData:
        """Return what a chain learns from, by the protocol."""
        protocol = protocol_of(learning.protocol, self.source)
        if protocol.tested is Tested.SECOND_PART:
            assert start is not None
            tuned = FirstPartDataModule(
                protocol,
                learning.target,
                offsets_of(start),
                data_root=self.data_root,
                labels=preset.labels,
                batch_size=preset.batch_intervals,
                batches=preset.batches_per_epoch,
            )
            tuned.setup()
            return self._joined(learning, preset, [self.measured, tuned], tuned)
        if protocol.pools:
            *sources, _ = self.sites_of(protocol.name, learning.target)
            pooled = PooledDataModule(
                sources,
                validation_site(sources),
                data_root=self.data_root,
                calibration=preset.calibration,
                labels=preset.labels,
                batch_size=preset.batch_intervals,
                batches=preset.batches_per_epoch,
            )
            pooled.setup()
            return self._joined(learning, preset, [pooled], pooled)
        return self._joined(learning, preset, [self.measured], self.measured)

    def _joined(
        self,
        learning: Learning,
        preset: Preset,
        measured: list[MeasuredDataModule | PooledDataModule | FirstPartDataModule],
        validating: MeasuredDataModule | PooledDataModule | FirstPartDataModule,
    ) -> TrainingData:
        streams: dict[str, object] = {}
        recordings: list[Recording] = []
        if preset.streams != "virtual":
            for module in measured:
                streams |= module.streams(learning.seed)
                recordings += module.recordings("train")
        if preset.streams != "measured":
            streams |= self._virtual(learning, preset)
        assert validating.offsets is not None
        return TrainingData(streams, validating.val_dataloader(), validating.offsets, _names(recordings))

    def _virtual(self, learning: Learning, preset: Preset) -> Mapping[str, object]:
        """Return the stream of a target's virtual site, drawn once for all chains of a seed that learn from it.

        No ablation changes the generator or what is drawn with it.
        """
        drawn = (learning.target, learning.seed)
        if drawn not in self._drawn:
            self._drawn[drawn] = self._synthetic(learning, preset)
        return self._drawn[drawn].train_dataloader()

    def _synthetic(self, learning: Learning, preset: Preset) -> SyntheticDataModule:
        """Return intervals of a target's virtual site, made by the generator of the source."""
        artifact = self._load(GENERATOR, Learning(SEEN, self.source, learning.seed))
        generator = artifact.networks[GENERATOR]
        assert isinstance(generator, Generator)
        dropout = Dropout(tuple(artifact.constants["heard_shares"]))
        site = virtual_site(self.packed[learning.target], generator, dropout, preset)
        return synthetic_data(site, preset, learning.seed)

    def _key(self, method: str, learning: Learning) -> ArtifactKey:
        name = self.preset.variant(learning.ablation).name
        return ArtifactKey(method, learning.protocol, learning.target, name, learning.seed)

    def _load(self, method: str, learning: Learning) -> Artifact:
        return load_artifact(
            self.artifacts,
            self._key(method, learning),
            data_hash=self.data_hash(learning),
            command=reproduce_command(self.preset.name, learning.target),
        )


def _names(recordings: list[Recording]) -> tuple[str, ...]:
    return tuple(one.key for one in recordings)
