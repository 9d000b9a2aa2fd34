"""Training of the generator on measured links."""

from __future__ import annotations

from torch import Tensor

from fploc.datasets.samples import LabelledIntervals
from fploc.models.generator import Generator
from fploc.tasks.streams import StreamTask


class GeneratorTask(StreamTask):
    """Maximum likelihood of range error and signal strength given true distance and crop.

    The paper's loss adds m² and dB² (eq. "gradient_rttrss"); a likelihood weighs both by their own spread
    and learns the spread as well.

    Args:
        network: The generator.
        learning_rate: Adam's.
        weight_decay: Adam's.
    """

    name = "generator"
    network: Generator

    def __init__(
        self,
        network: Generator,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-5,
    ) -> None:
        super().__init__(network, learning_rate, weight_decay)

    def _shared_step(self, batch: LabelledIntervals, stage: str) -> Tensor:
        links = batch.links
        ends = batch.positions[links.device]
        crops = self.network.vision.crops.crop(batch.plan, links.access_points, ends)
        distances = (ends - links.access_points).norm(dim=-1)
        errors = links.ranges - distances
        distribution = self.network(crops.images, crops.lengths_px, distances)
        loss = -(distribution.log_prob_error(errors) + distribution.log_prob_rss(links.rss, errors)).mean()
        count = len(distances)
        self.log_mean(f"{stage}/loss", loss, count)
        absolute = (distribution.mean_error() - errors).abs().mean()
        self.log_mean(f"{stage}/range_mae_m", absolute, count)
        return loss
