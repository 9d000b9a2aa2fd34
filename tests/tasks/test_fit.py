"""Real trainings of two steps, on two streams, and what they leave behind."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import lightning.pytorch as pl
import pytest
import torch
from torch.utils.data import DataLoader

from fploc.datasets.samples import LabelledIntervals
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, CorrectionHead
from fploc.models.generator import Generator
from fploc.models.gnn import GNN
from fploc.tasks.fpdnn import FPDNNTask
from fploc.tasks.generator import GeneratorTask
from fploc.tasks.gnn import GNNTask

pytestmark = pytest.mark.filterwarnings("ignore:.*does not have many workers", "ignore:.*GPU available")


def vision() -> DeepViT:
    return DeepViT(
        crop_height_px=20, max_length_px=80, patch_px=(20, 10), dim=8, depth=1, num_heads=2, head_dim=4
    )


def gnn_task() -> GNNTask:
    return GNNTask(GNN(hidden=8, message_width=4, layers=2), learning_rate=0.01)


def fpdnn_task() -> FPDNNTask:
    network = FPDNN(vision(), CorrectionHead(64))
    return FPDNNTask(network, learning_rate=0.01)


def generator_task() -> GeneratorTask:
    network = Generator(vision())
    return GeneratorTask(network, learning_rate=0.01)


METRICS: list[tuple[Callable[[], pl.LightningModule], set[str]]] = [
    (gnn_task, {"train/loss", "val/loss", "val/rmse_m"}),
    (fpdnn_task, {"train/loss", "train/range_mae_m", "val/loss", "val/range_mae_m"}),
    (generator_task, {"train/loss", "train/range_mae_m", "val/loss", "val/range_mae_m"}),
]


def fitted(
    make_task: Callable[[], pl.LightningModule],
    make_batch: Callable[..., LabelledIntervals],
    folder: Path,
) -> tuple[pl.LightningModule, pl.Trainer]:
    pl.seed_everything(3, verbose=False)
    task = make_task()
    streams = {
        "measured": DataLoader([make_batch(1), make_batch(2)], batch_size=None),
        "virtual": DataLoader([make_batch(3, linked=True), make_batch(4, linked=True)], batch_size=None),
    }
    trainer = pl.Trainer(
        max_steps=2,
        accelerator="cpu",
        devices=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        gradient_clip_val=1.0,
        default_root_dir=folder,
    )
    trainer.fit(task, train_dataloaders=streams, val_dataloaders=DataLoader([make_batch(5)], batch_size=None))
    return task, trainer


@pytest.mark.parametrize(("make_task", "names"), METRICS)
def test_two_steps_train_every_network_and_log_its_metrics(
    make_task: Callable[[], pl.LightningModule],
    names: set[str],
    make_batch: Callable[..., LabelledIntervals],
    tmp_path: Path,
) -> None:
    task, trainer = fitted(make_task, make_batch, tmp_path)
    assert trainer.global_step == 2
    assert set(trainer.callback_metrics) == names
    assert all(math.isfinite(float(value)) for value in trainer.callback_metrics.values())
    pl.seed_everything(3, verbose=False)
    untrained = make_task().state_dict()
    trained = task.state_dict()
    assert all(torch.isfinite(value).all() for value in trained.values())
    assert any(not torch.equal(value, untrained[name]) for name, value in trained.items())


@pytest.mark.parametrize("make_task", [gnn_task, fpdnn_task, generator_task])
def test_one_seed_gives_one_network(
    make_task: Callable[[], pl.LightningModule],
    make_batch: Callable[..., LabelledIntervals],
    tmp_path: Path,
) -> None:
    first, second = (fitted(make_task, make_batch, tmp_path)[0].state_dict() for _ in range(2))
    assert all(torch.equal(value, second[name]) for name, value in first.items())


@pytest.mark.parametrize("make_task", [gnn_task, fpdnn_task, generator_task])
def test_the_optimizer_is_adam_with_the_published_decay(make_task: Callable[[], pl.LightningModule]) -> None:
    optimizer = make_task().configure_optimizers()
    assert isinstance(optimizer, torch.optim.Adam)
    assert optimizer.defaults["lr"] == 0.01 and optimizer.defaults["weight_decay"] == 1e-5


def test_published_learning_rates_are_the_defaults() -> None:
    network = FPDNN(vision(), CorrectionHead(64))
    assert GNNTask(GNN(hidden=8, message_width=4, layers=2)).learning_rate == 2e-4
    assert FPDNNTask(network).learning_rate == 1e-3
    assert GeneratorTask(Generator(vision())).learning_rate == 1e-3
