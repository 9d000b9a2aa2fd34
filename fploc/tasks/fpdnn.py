"""Training of FPDNN on links seen from positions as wrong as the GNN's will be."""

from __future__ import annotations

import torch
from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.errors import FplocError
from fploc.floorplan.augmentation import CropAugmentation
from fploc.models.fpdnn import FPDNN, Sight
from fploc.tasks.streams import StreamTask


class FPDNNTask(StreamTask):
    """Mean squared error of the distance (paper, eq. "gradient").

    The crop is taken from a coarse position, not from the true one: the truth is moved by Gaussian jitter
    of the size of the GNN's error, one draw per device, since its links share the coarse position.

    In training, crops are distorted and some links see the length of their crop alone, or nothing of the
    plan. Against memory: a source of one loop and few access points has few crops, which a network learns
    by heart. Validation sees every crop, as it is.

    Args:
        network: FPDNN.
        jitter_m: Standard deviation of the jitter per axis, metres.
        augmentation: Distortions of crops in training.
        sight_shares: Shares of links in training that see the plan, the length alone and nothing of it, in
            the order of ``Sight``; they sum to 1.
        learning_rate: Adam's.
        weight_decay: Adam's.

    Raises:
        FplocError: If the shares are negative or do not sum to 1.
    """

    name = "fpdnn"
    network: FPDNN

    def __init__(
        self,
        network: FPDNN,
        jitter_m: float = 1.0,
        augmentation: CropAugmentation = CropAugmentation(),
        sight_shares: tuple[float, float, float] = (0.8, 0.1, 0.1),
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-5,
    ) -> None:
        super().__init__(network, learning_rate, weight_decay)
        self.jitter_m = jitter_m
        self.augmentation = augmentation
        if min(sight_shares) < 0.0 or abs(sum(sight_shares) - 1.0) > 1e-6:
            raise FplocError(
                "sight_shares of FPDNN's training",
                value=list(sight_shares),
                expected="three shares that sum to 1",
                way_out="correct `sight_shares`",
            )
        self.sight_shares = sight_shares

    def drawn_sight(self, links: int) -> Tensor:
        """Return a random ``Sight`` of each of ``links`` links, shape (L,), int64."""
        shares = torch.tensor(self.sight_shares, device=self.device)
        return torch.multinomial(shares, links, replacement=True)

    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        links = batch.links
        coarse = batch.positions + self.jitter_m * torch.randn_like(batch.positions)
        count = len(links.ranges)
        training = stage == "train"
        distortions = self.augmentation.draw(count, coarse.device) if training else None
        crops = self.network.vision.crops.crop(
            batch.plan, links.access_points, coarse[links.device], distortions
        )
        sight = self.drawn_sight(count) if training else torch.full_like(links.device, Sight.PLAN)
        estimated = self.network(crops.images, crops.lengths_px, links.ranges, links.rss, sight)
        distances = (batch.positions[links.device] - links.access_points).norm(dim=-1)
        loss = torch.nn.functional.mse_loss(estimated, distances)
        self.log_mean(f"{stage}/loss", loss, count)
        absolute = (estimated - distances).abs().mean()
        self.log_mean(f"{stage}/range_mae_m", absolute, count)
        return loss
