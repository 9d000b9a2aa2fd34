"""Trainings of the paper's chain, in their order: generator, then GNN and FPDNN, then adapted to a target.

Design §8 of the method: the generator learns on the source's recordings; GNN and FPDNN learn on these and
on the source's virtual site; for a target they go on learning with the target's virtual site beside the
source's recordings, so that of the target only plan and access points are used.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import lightning.pytorch as pl
import numpy as np
import torch
from lightning.pytorch.callbacks import RichProgressBar
from lightning.pytorch.loggers import Logger

from datamodules.measured import MeasuredDataModule
from datamodules.synthetic import SyntheticDataModule
from fploc.artifacts import Artifact, ArtifactKey
from fploc.calibration.offsets import RangeOffsets
from fploc.conf import instantiate
from fploc.datasets.packed import PackedSite
from fploc.datasets.recordings import Recording
from fploc.experiments.preset import Preset
from fploc.floorplan.augmentation import CropAugmentation
from fploc.models.fpdnn import FPDNN
from fploc.models.generator import Generator
from fploc.models.gnn import GNN
from fploc.progress import is_shown
from fploc.sites.site import Site
from fploc.tasks.fpdnn import FPDNNTask
from fploc.tasks.generator import GeneratorTask
from fploc.tasks.gnn import GNNTask
from fploc.virtual.dropout import Dropout
from fploc.virtual.site import VirtualSite

GRADIENT_LIMIT = 1.0

Loggers = Callable[[str], Logger | None]
"""From the name of a network to where its training logs, or None for nowhere."""


@dataclass(frozen=True)
class Trained:
    """Networks of the chain and what validation says of them.

    Args:
        gnn: In evaluation mode.
        fpdnn: In evaluation mode.
        variance_m2: Variance of the GNN's positions per axis on the validation recordings, square metres.
        sigma_m: Root mean squared error of FPDNN's distances there, metres.
    """

    gnn: GNN
    fpdnn: FPDNN
    variance_m2: float
    sigma_m: float


def fit(
    task: pl.LightningModule,
    streams: Mapping[str, object],
    validation: object,
    *,
    epochs: int,
    logger: Logger | None,
    folder: Path,
) -> dict[str, float]:
    """Train ``task`` on ``streams`` and return its validation metrics; Lightning places it on a device."""
    trainer = pl.Trainer(
        max_epochs=epochs,
        logger=logger if logger is not None else False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=is_shown(),
        callbacks=[RichProgressBar()] if is_shown() else [],
        gradient_clip_val=GRADIENT_LIMIT,
        num_sanity_val_steps=0,
        check_val_every_n_epoch=max(1, epochs // 5),
        log_every_n_steps=10,
        default_root_dir=folder,
        devices=1,
    )
    try:
        trainer.fit(task, train_dataloaders=dict(streams), val_dataloaders=validation)
    except SystemExit as stopped:
        # Lightning answers an interruption by leaving the process.
        raise KeyboardInterrupt from stopped
    metrics = trainer.validate(task, dataloaders=validation, verbose=False)[0]
    task.cpu().eval()
    return {name: float(value) for name, value in metrics.items()}


def fit_dropout(recordings: list[Recording], site: Site, labels: str) -> Dropout:
    """Return how often links of the recordings were heard, by distance."""
    positions = np.concatenate([one.labels_m(labels) for one in recordings])
    heard = np.concatenate([one.heard for one in recordings])
    known = np.isfinite(positions).all(axis=1)
    distances = np.linalg.norm(positions[known, None] - site.positions_m, axis=2)
    return Dropout.fit(distances, heard[known])


def train_generator(
    preset: Preset, measured: MeasuredDataModule, seed: int, *, loggers: Loggers, folder: Path
) -> tuple[Generator, dict[str, float]]:
    """Train the generator on the source's recordings."""
    pl.seed_everything(seed, verbose=False)
    network = instantiate(Generator, preset.network_specs["generator"])
    task = GeneratorTask(network, learning_rate=preset.learning_rates["generator"])
    metrics = fit(
        task,
        measured.streams(seed),
        measured.val_dataloader(),
        epochs=preset.epochs["generator"],
        logger=loggers("generator"),
        folder=folder,
    )
    return network, metrics


def virtual_site(packed: PackedSite, generator: Generator, dropout: Dropout, preset: Preset) -> VirtualSite:
    """Return the virtual site of a packed one: its plan and access points, none of its measurements."""
    return VirtualSite(
        packed.site,
        packed.plan,
        generator,
        generator.vision.crops,
        dropout,
        preset.random_layout_share,
    )


def synthetic_data(site: VirtualSite, preset: Preset, seed: int) -> SyntheticDataModule:
    """Return the data module of a virtual site, with batches as large as the measured ones."""
    synthetic = SyntheticDataModule(
        site,
        pairs=max(1, preset.batch_intervals // 2),
        batches=preset.batches_per_epoch,
        pool_batches=preset.pool_batches,
        seed=seed,
    )
    synthetic.setup()
    return synthetic


@dataclass(frozen=True)
class TrainingData:
    """What a chain learns from.

    Args:
        streams: Loaders of training batches, by name.
        validation: Loader of what validates.
        offsets: Range offsets that all ranges are behind.
        recordings: Measured recordings in the streams, as ``site/name``.
    """

    streams: Mapping[str, object]
    validation: object
    offsets: RangeOffsets
    recordings: tuple[str, ...]


def train_chain(
    preset: Preset,
    data: TrainingData,
    seed: int,
    *,
    start: Trained | None,
    coarse: Trained | None,
    loggers: Loggers,
    folder: Path,
) -> Trained:
    """Train GNN and FPDNN.

    Args:
        preset: Sizes of the training.
        data: What to learn from.
        seed: Of initialisation, jitter and turns.
        start: Networks to go on from; None for new ones.
        coarse: Whose GNN to take as it is; None to train one.
        loggers: Where the metrics of each network go.
        folder: Lightning's working folder.
    """
    pl.seed_everything(seed, verbose=False)
    if coarse is None:
        gnn, variance_m2 = train_gnn(preset, data, start=start, logger=loggers("gnn"), folder=folder)
    else:
        gnn, variance_m2 = coarse.gnn, coarse.variance_m2
    fpdnn, sigma_m = train_fpdnn(
        preset, data, variance_m2**0.5, start=start, logger=loggers("fpdnn"), folder=folder
    )
    return Trained(gnn, fpdnn, variance_m2, sigma_m)


def train_gnn(
    preset: Preset, data: TrainingData, *, start: Trained | None, logger: Logger | None, folder: Path
) -> tuple[GNN, float]:
    """Train the GNN and return it with the variance of its positions per axis, square metres."""
    gnn = instantiate(GNN, preset.network_specs["gnn"]) if start is None else copy.deepcopy(start.gnn).train()
    metrics = fit(
        GNNTask(gnn, learning_rate=preset.learning_rates["gnn"]),
        data.streams,
        data.validation,
        epochs=preset.epochs["gnn" if start is None else "gnn_adapted"],
        logger=logger,
        folder=folder,
    )
    return gnn, metrics["val/loss"] / 2.0


def train_fpdnn(
    preset: Preset,
    data: TrainingData,
    jitter_m: float,
    *,
    start: Trained | None,
    logger: Logger | None,
    folder: Path,
) -> tuple[FPDNN, float]:
    """Train FPDNN on positions off by ``jitter_m`` per axis; return it and its RMSE of distances, metres."""
    fpdnn = (
        instantiate(FPDNN, preset.network_specs["fpdnn"])
        if start is None
        else copy.deepcopy(start.fpdnn).train()
    )
    task = FPDNNTask(
        fpdnn,
        jitter_m=jitter_m,
        learning_rate=preset.learning_rates["fpdnn"],
        augmentation=CropAugmentation(**preset.augmentation),
        sight_shares=preset.sight_shares,
    )
    metrics = fit(
        task,
        data.streams,
        data.validation,
        epochs=preset.epochs["fpdnn" if start is None else "fpdnn_adapted"],
        logger=logger,
        folder=folder,
    )
    return fpdnn, metrics["val/loss"] ** 0.5


def chain_artifacts(
    trained: Trained,
    preset: Preset,
    data: TrainingData,
    *,
    protocol: str,
    target: str,
    seed: int,
    data_hash: str,
    command: str,
) -> list[Artifact]:
    """Return the artifacts of ``gnn`` and ``gnn-fpdnn`` for a target."""
    constants: dict[str, Any] = {
        "offsets": asdict(data.offsets),
        "variance_m2": trained.variance_m2,
        "sigma_m": trained.sigma_m,
        "solver": preset.solver,
    }
    networks: dict[str, dict[str, torch.nn.Module]] = {
        "gnn": {"gnn": trained.gnn},
        "gnn-fpdnn": {"gnn": trained.gnn, "fpdnn": trained.fpdnn},
    }
    return [
        Artifact(
            key=ArtifactKey(method, protocol, target, preset.name, seed),
            specs={name: preset.network_specs[name] for name in parts},
            networks=parts,
            constants=constants,
            data_hash=data_hash,
            recordings=data.recordings,
            command=command,
        )
        for method, parts in networks.items()
    ]


def trained_from(artifact: Artifact) -> Trained:
    """Return the chain that an artifact of ``gnn-fpdnn`` holds."""
    return Trained(
        gnn=cast(GNN, artifact.networks["gnn"]),
        fpdnn=cast(FPDNN, artifact.networks["fpdnn"]),
        variance_m2=float(artifact.constants["variance_m2"]),
        sigma_m=float(artifact.constants["sigma_m"]),
    )
