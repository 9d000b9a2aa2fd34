"""How long a reproduction will take here: a few training steps, timed and multiplied."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from datetime import timedelta

import torch

from datamodules.measured import MeasuredDataModule
from fploc.conf import instantiate
from fploc.datasets.samples import LabelledIntervals
from fploc.experiments.preset import Preset
from fploc.models.fpdnn import FPDNN
from fploc.models.generator import Generator

STREAMS = 2
"""Measured and virtual batches alternate, and a virtual one is drawn by the generator."""


def training_steps(preset: Preset, targets: int) -> dict[str, int]:
    """Return how many batches the generator and FPDNN learn from in all trainings of a preset."""
    epochs, batches = preset.epochs, preset.batches_per_epoch * len(preset.seeds)
    return {
        "generator": epochs["generator"] * batches,
        "fpdnn": STREAMS * (epochs["fpdnn"] + targets * epochs["fpdnn_adapted"]) * batches,
    }


def estimate_seconds(preset: Preset, measured: MeasuredDataModule, targets: int) -> float:
    """Return the time that the trainings on crops will take here, seconds; the GNN's is negligible."""
    batch = next(iter(measured.train_dataloader()["measured"]))
    steps = training_steps(preset, targets)
    return steps["generator"] * _seconds(_generator_step(preset, batch)) + steps["fpdnn"] * _seconds(
        _fpdnn_step(preset, batch)
    )


def announce_duration(preset: Preset, measured: MeasuredDataModule, targets: int) -> None:
    """Say on stderr how long the preset will take from its start."""
    device = "GPU" if torch.cuda.is_available() else "CPU"
    seconds = round(estimate_seconds(preset, measured, targets))
    advice = "" if device == "GPU" or seconds < 4 * 3600 else "; a GPU is advised"
    text = f"preset {preset.name}: trainings take about {timedelta(seconds=seconds)} on this {device}{advice}"
    print(text, file=sys.stderr, flush=True)  # noqa: T201


def _generator_step(preset: Preset, batch: LabelledIntervals) -> Callable[[], torch.Tensor]:
    network = instantiate(Generator, preset.network_specs["generator"])
    links = batch.links
    ends = batch.positions[links.device]

    def loss() -> torch.Tensor:
        crops = network.vision.crops.crop(batch.plan, links.access_points, ends)
        return network(crops.images, crops.lengths_px, links.ranges).log_prob_error(links.ranges).sum()

    return loss


def _fpdnn_step(preset: Preset, batch: LabelledIntervals) -> Callable[[], torch.Tensor]:
    network = instantiate(FPDNN, preset.network_specs["fpdnn"])
    links = batch.links
    ends = batch.positions[links.device]

    def loss() -> torch.Tensor:
        crops = network.vision.crops.crop(batch.plan, links.access_points, ends)
        distances: torch.Tensor = network(crops.images, crops.lengths_px, links.ranges, links.rss)
        return distances.sum()

    return loss


def _seconds(loss: Callable[[], torch.Tensor]) -> float:
    """Return the time of one forward and backward pass, after one to warm up."""
    loss().backward()
    started = time.perf_counter()
    loss().backward()
    return time.perf_counter() - started
