"""The logged numbers against the same numbers computed by hand."""

from __future__ import annotations

from collections.abc import Callable

import lightning.pytorch as pl
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from fploc.datasets.samples import LabelledIntervals
from fploc.errors import FplocError
from fploc.floorplan.augmentation import CropAugmentation, Distortions
from fploc.floorplan.crop import Crops
from fploc.floorplan.raster import CropSettings, PlanRaster
from fploc.graphs.first_estimates import first_estimates
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, CorrectionHead, Sight
from fploc.models.generator import Generator
from fploc.models.gnn import GNN
from fploc.tasks.fpdnn import FPDNNTask
from fploc.tasks.generator import GeneratorTask
from fploc.tasks.gnn import GNNTask, random_turn

pytestmark = pytest.mark.filterwarnings("ignore:.*does not have many workers", "ignore:.*self.trainer")


def vision() -> DeepViT:
    torch.manual_seed(0)
    return DeepViT(
        crop_height_px=20, max_length_px=80, patch_px=(20, 10), dim=8, depth=1, num_heads=2, head_dim=4
    )


def fpdnn_task(jitter_m: float, sight_shares: tuple[float, float, float] = (0.8, 0.1, 0.1)) -> FPDNNTask:
    network = FPDNN(vision(), CorrectionHead(64))
    return FPDNNTask(network, jitter_m=jitter_m, sight_shares=sight_shares)


def validated(task: pl.LightningModule, *batches: LabelledIntervals) -> dict[str, float]:
    trainer = pl.Trainer(
        accelerator="cpu",
        devices=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    return dict(trainer.validate(task, DataLoader(list(batches), batch_size=None), verbose=False)[0])


def true_distances(batch: LabelledIntervals) -> Tensor:
    """Distance of every link, in the order of the mask."""
    return (batch.positions[:, None] - batch.access_points).norm(dim=-1)[batch.intervals.heard]


def test_gnn_loss_is_the_mean_squared_distance(make_batch: Callable[..., LabelledIntervals]) -> None:
    batch = make_batch(1)
    first = first_estimates(batch.intervals, batch.access_points)
    expected = float((first - batch.positions).square().sum(-1).mean())
    # An untrained GNN stays at the first estimates.
    metrics = validated(GNNTask(GNN(hidden=8, message_width=4, layers=2)), batch)
    assert metrics == pytest.approx({"val/loss": expected, "val/rmse_m": expected**0.5}, rel=1e-4)


def test_gnn_loss_of_noise_free_batches_is_zero_however_they_are_turned(
    make_batch: Callable[..., LabelledIntervals],
) -> None:
    task = GNNTask(GNN(hidden=8, message_width=4, layers=2))
    batches = {"measured": make_batch(1, bias_m=0.0), "virtual": make_batch(2, bias_m=0.0, linked=True)}
    for _ in range(5):
        assert float(task.training_step(batches, 0).detach()) < 1e-6


def test_gnn_is_turned_in_training_only(
    make_batch: Callable[..., LabelledIntervals], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Tensor] = []

    def spy(graph: object) -> Tensor:
        seen.append(graph.pos[graph.devices :])  # type: ignore[attr-defined]
        return graph.pos[: graph.devices]  # type: ignore[attr-defined]

    task, batch = GNNTask(GNN(hidden=8, message_width=4, layers=1)), make_batch(1)
    monkeypatch.setattr(task.network, "forward", spy)
    task.training_step({"measured": batch}, 0)
    task.validation_step(batch, 0)
    turned, level = seen
    torch.testing.assert_close(level, batch.access_points)
    assert (turned - level).abs().max() > 1e-3
    torch.testing.assert_close(turned.norm(dim=-1), level.norm(dim=-1))


def test_turns_are_rotations_and_reflections_of_every_angle() -> None:
    torch.manual_seed(0)
    turns = torch.stack([random_turn(torch.device("cpu")) for _ in range(200)])
    torch.testing.assert_close(turns @ turns.mT, torch.eye(2).expand(200, 2, 2), rtol=0.0, atol=1e-6)
    mirrored = turns.det() < 0
    assert 60 < int(mirrored.sum()) < 140
    angles = torch.atan2(turns[:, 1, 0], turns[:, 0, 0])
    assert np.histogram(angles.numpy(), bins=4, range=(-np.pi, np.pi))[0].min() > 25


def test_fpdnn_loss_is_the_mean_squared_error_of_the_distance(
    make_batch: Callable[..., LabelledIntervals],
) -> None:
    batch = make_batch(1, bias_m=0.7)
    # An untrained correction returns the ranges.
    errors = batch.intervals.ranges[batch.intervals.heard] - true_distances(batch)
    expected = {"val/loss": float(errors.square().mean()), "val/range_mae_m": float(errors.abs().mean())}
    assert validated(fpdnn_task(1.0), batch) == pytest.approx(expected, rel=1e-4)
    assert expected["val/range_mae_m"] == pytest.approx(0.7, rel=1e-4)


def test_metrics_weigh_batches_by_their_links(make_batch: Callable[..., LabelledIntervals]) -> None:
    batches = [make_batch(1, bias_m=1.0, devices=2), make_batch(2, bias_m=3.0, devices=12)]
    counts = [len(true_distances(batch)) for batch in batches]
    expected = (1.0 * counts[0] + 3.0 * counts[1]) / sum(counts)
    assert validated(fpdnn_task(0.0), *batches)["val/range_mae_m"] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("jitter_m", [0.0, 2.0])
def test_crops_are_taken_from_one_jittered_position_for_each_device(
    make_batch: Callable[..., LabelledIntervals], monkeypatch: pytest.MonkeyPatch, jitter_m: float
) -> None:
    batch = make_batch(1, devices=400)
    taken: list[Tensor] = []
    original = CropSettings.crop

    def spy(
        self: CropSettings, plan: PlanRaster, starts: Tensor, ends: Tensor, distortions: Distortions
    ) -> Crops:
        taken.append(ends)
        return original(self, plan, starts, ends, distortions)

    monkeypatch.setattr(CropSettings, "crop", spy)
    torch.manual_seed(0)
    fpdnn_task(jitter_m).training_step({"measured": batch}, 0)
    (ends,) = taken
    device = batch.links.device
    offsets = ends - batch.positions[device]
    first = torch.stack([offsets[device == index][0] for index in range(400)])
    torch.testing.assert_close(offsets, first[device], rtol=0.0, atol=1e-5)
    assert float(first.std()) == pytest.approx(jitter_m, rel=0.1)
    assert float(first.mean(0).abs().max()) <= 0.15 * jitter_m + 1e-5


def test_sight_is_drawn_in_its_shares_in_training_only(
    make_batch: Callable[..., LabelledIntervals],
) -> None:
    batch = make_batch(1, devices=1000)
    task = fpdnn_task(1.0, sight_shares=(0.5, 0.2, 0.3))
    seen: list[Tensor] = []
    task.network.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[-1]))
    torch.manual_seed(0)
    task.training_step({"measured": batch}, 0)
    task.validation_step(batch, 0)
    training, validation = seen
    shares = torch.bincount(training, minlength=3) / len(training)
    np.testing.assert_allclose(shares, (0.5, 0.2, 0.3), atol=0.03)
    assert set(validation.tolist()) == {Sight.PLAN}


@pytest.mark.parametrize("shares", [(0.5, 0.2, 0.2), (1.2, -0.1, -0.1)])
def test_shares_that_are_none_are_refused(shares: tuple[float, float, float]) -> None:
    with pytest.raises(FplocError, match="three shares that sum to 1"):
        fpdnn_task(1.0, sight_shares=shares)


def test_crops_are_distorted_in_training_only(
    make_batch: Callable[..., LabelledIntervals], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[Distortions | None] = []
    original = CropSettings.crop

    def spy(
        self: CropSettings, plan: PlanRaster, starts: Tensor, ends: Tensor, distortions: Distortions | None
    ) -> Crops:
        taken.append(distortions)
        return original(self, plan, starts, ends, distortions)

    monkeypatch.setattr(CropSettings, "crop", spy)
    batch = make_batch(1)
    task = FPDNNTask(FPDNN(vision(), CorrectionHead(64)), augmentation=CropAugmentation(along_m=0.7))
    task.training_step({"measured": batch}, 0)
    task.validation_step(batch, 0)
    drawn, none = taken
    assert none is None and drawn is not None
    assert len(drawn.along) == len(batch.links.ranges) and 0.3 < float(drawn.along.abs().max()) <= 0.7


def test_generator_loss_is_the_negative_log_likelihood(make_batch: Callable[..., LabelledIntervals]) -> None:
    batch = make_batch(1)
    network = Generator(vision()).eval()
    distances = true_distances(batch)
    heard = batch.intervals.heard
    device, access_point = torch.nonzero(heard, as_tuple=True)
    starts, ends = batch.access_points[access_point], batch.positions[device]
    crops = network.vision.crops.crop(batch.plan, starts, ends)
    with torch.no_grad():
        made = network(crops.images, crops.lengths_px, distances)
        errors = batch.intervals.ranges[heard] - distances
        joint = made.log_prob_error(errors) + made.log_prob_rss(batch.intervals.rss[heard], errors)
        absolute = (made.mean_error() - errors).abs()
    expected = {"val/loss": float(-joint.mean()), "val/range_mae_m": float(absolute.mean())}
    metrics = validated(GeneratorTask(network), batch)
    assert metrics == pytest.approx(expected, rel=1e-4)


def test_training_loss_is_the_mean_over_streams(make_batch: Callable[..., LabelledIntervals]) -> None:
    task = fpdnn_task(0.0).eval()
    batches = {"measured": make_batch(1, bias_m=1.0), "virtual": make_batch(2, bias_m=3.0, linked=True)}
    assert float(task.training_step(batches, 0).detach()) == pytest.approx((1.0 + 9.0) / 2, rel=1e-4)
