"""How long a reproduction will take here: a few training steps, timed and multiplied."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from datetime import timedelta

import torch

from datamodules.measured import MeasuredDataModule
from fploc.conf import instantiate
from fploc.datasets.samples import LabelledIntervals
from fploc.experiments.plan import SEEN, Learning
from fploc.experiments.preset import Preset
from fploc.floorplan.crop import Crops
from fploc.floorplan.raster import CropSettings
from fploc.intervals import Links
from fploc.models.fpdnn import FPDNN, Sight
from fploc.models.generator import Generator

STREAMS = 2
"""FPDNN learns from a measured and a virtual batch at each step."""
LONG_S = 4 * 3600.0


def training_steps(preset: Preset, chains: Sequence[Learning]) -> dict[str, int]:
    """Return how many batches the generator and FPDNN learn from in all trainings of a preset."""
    epochs, batches = preset.epochs, preset.batches_per_epoch
    new = sum(one.protocol == SEEN for one in chains)
    passes = new * epochs["fpdnn"] + (len(chains) - new) * epochs["fpdnn_adapted"]
    return {
        "generator": epochs["generator"] * batches * len(preset.seeds),
        "fpdnn": STREAMS * passes * batches,
    }


def virtual_draws(preset: Preset, chains: Sequence[Learning]) -> int:
    """Return how many virtual batches the generator draws: chains of one target and seed share them."""
    return preset.pool_batches * len({(one.target, one.seed) for one in chains})


def estimate_seconds(
    preset: Preset, measured: MeasuredDataModule, chains: Sequence[Learning], device: str
) -> float:
    """Return the time that learning from crops on ``device`` and drawing virtual batches take, seconds.

    The GNN, validation and scoring come on top; they are small beside these.
    """
    batch = next(iter(measured.train_dataloader()["measured"]))
    steps = training_steps(preset, chains)
    generator, fpdnn = _generator_loss(preset, batch, device), _fpdnn_loss(preset, batch, device)
    return (
        steps["generator"] * _seconds(lambda: generator().backward())
        + steps["fpdnn"] * _seconds(lambda: fpdnn().backward())
        + virtual_draws(preset, chains) * _seconds(_generator_loss(preset, batch, "cpu"))
    )


def announce_duration(preset: Preset, measured: MeasuredDataModule, chains: Sequence[Learning]) -> None:
    """Say on stderr how long the trainings of a preset will take from their start."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    seconds = estimate_seconds(preset, measured, chains, device)
    advice = "; a GPU is advised" if device == "cpu" and seconds > LONG_S else ""
    told = {"cuda": "this GPU", "cpu": "this CPU"}[device]
    duration = timedelta(seconds=round(seconds))
    text = f"preset {preset.name}: trainings take about {duration} on {told}{advice}"
    print(text, file=sys.stderr, flush=True)  # noqa: T201


def _generator_loss(preset: Preset, batch: LabelledIntervals, device: str) -> Callable[[], torch.Tensor]:
    network = instantiate(Generator, preset.network_specs["generator"]).to(device)

    def of_links(crops: Crops, links: Links) -> torch.Tensor:
        return network(crops.images, crops.lengths_px, links.ranges).log_prob_error(links.ranges).sum()

    return _loss(network.vision.crops, of_links, batch.to(device))


def _fpdnn_loss(preset: Preset, batch: LabelledIntervals, device: str) -> Callable[[], torch.Tensor]:
    network = instantiate(FPDNN, preset.network_specs["fpdnn"]).to(device)

    def of_links(crops: Crops, links: Links) -> torch.Tensor:
        sight = torch.full_like(links.device, Sight.PLAN)
        distances: torch.Tensor = network(crops.images, crops.lengths_px, links.ranges, links.rss, sight)
        return distances.sum()

    return _loss(network.vision.crops, of_links, batch.to(device))


def _loss(
    settings: CropSettings, of_links: Callable[[Crops, Links], torch.Tensor], batch: LabelledIntervals
) -> Callable[[], torch.Tensor]:
    """Return what crops every link of a batch and takes a loss of the crops."""
    links = batch.links
    ends = batch.positions[links.device]
    return lambda: of_links(settings.crop(batch.plan, links.access_points, ends), links)


def _seconds(step: Callable[[], object]) -> float:
    """Return the time of one step, after one to warm up."""
    step()
    started = time.perf_counter()
    step()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter() - started
