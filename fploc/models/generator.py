"""The generator: what a phone would measure over a link of known length across a known plan."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import RANGE_SCALE_M, RSS_CENTRE_DBM, RSS_SCALE_DB, ffnn

SMALLEST_SPREAD = 0.02


@dataclass(frozen=True)
class MeasurementDistribution:
    """Joint distribution of the range error e = ζ − d and of the signal strength γ of each link.

    e is an exponentially modified Gaussian: a normal (shift, spread) plus an exponential (tail), so that
    blocked paths lengthen ranges to the right. γ given e is normal with mean ``rss_mean`` + ``rss_slope``·e.

    Args:
        shift: Mean of the normal part, shape (B,), metres.
        spread: Its standard deviation, shape (B,), metres.
        tail: Mean of the exponential part, shape (B,), metres.
        rss_mean: Signal strength at e = 0, shape (B,), dBm.
        rss_slope: Change of signal strength with the error, shape (B,), dB per metre.
        rss_spread: Standard deviation of γ given e, shape (B,), dB.
    """

    shift: Tensor
    spread: Tensor
    tail: Tensor
    rss_mean: Tensor
    rss_slope: Tensor
    rss_spread: Tensor

    def log_prob_error(self, errors: Tensor) -> Tensor:
        """Return log p(e), shape (B,), of range errors (B,) in metres."""
        standard = (errors - self.shift) / self.spread - self.spread / self.tail
        return (
            -torch.log(self.tail)
            + (self.shift - errors) / self.tail
            + 0.5 * (self.spread / self.tail) ** 2
            + torch.special.log_ndtr(standard)
        )

    def log_prob_rss(self, rss: Tensor, errors: Tensor) -> Tensor:
        """Return log p(γ | e), shape (B,), of signal strengths (B,) in dBm."""
        return torch.distributions.Normal(self.rss_mean + self.rss_slope * errors, self.rss_spread).log_prob(
            rss
        )

    def sample(self, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return range errors (B,) in metres and signal strengths (B,) in dBm."""
        normal = torch.randn(2, *self.shift.shape, generator=generator, device=self.shift.device)
        uniform = torch.rand(self.shift.shape, generator=generator, device=self.shift.device)
        errors = self.shift + self.spread * normal[0] - self.tail * torch.log1p(-uniform)
        rss = self.rss_mean + self.rss_slope * errors + self.rss_spread * normal[1]
        return errors, rss

    def mean_error(self) -> Tensor:
        """Return E[e], shape (B,), metres."""
        return self.shift + self.tail

    def mean_rss(self) -> Tensor:
        """Return E[γ], shape (B,), dBm."""
        return self.rss_mean + self.rss_slope * self.mean_error()


class Generator(nn.Module):
    """The paper's DNN φ_D(d, I): true distance and crop to RTT and RSS, as a distribution.

    Paper: Yu et al., section "Synthetic Data Generation", Table II (FFNN3, FFNN4). Changed: the output is a
    distribution, not a conditional mean, since means make data that are too clean: FFNN4 ends in six values
    instead of two; no ReLU behind it, which could not give a signal strength in dBm, and no dropout, which
    would set outputs to zero at random; distance and signal strength are normalised. FFNN3, "the same
    structure" as FFNN1, takes two inputs, while the paper has one, the distance: the other is its logarithm,
    in which path loss is linear.

    Args:
        vision: The network on crops.
        drop: Dropout rate of FFNN3.

    Shapes:
        - **input:** images (B, 1, H, W), lengths_px (B,), distances (B,) metres
        - **output:** ``MeasurementDistribution`` of B links
    """

    def __init__(self, vision: DeepViT, drop: float = 0.2) -> None:
        super().__init__()
        self.vision = vision
        self.ffnn3 = ffnn(2, 64, 32, drop)
        self.ffnn4 = nn.Sequential(nn.Linear(64, 32), nn.ReLU(), nn.LayerNorm(32), nn.Linear(32, 6))

    def forward(self, images: Tensor, lengths_px: Tensor, distances: Tensor) -> MeasurementDistribution:
        """Return the distribution of the measurements of links; see the class for shapes."""
        geometry = torch.stack(
            [distances / RANGE_SCALE_M - 1.0, torch.log10(distances.clamp(min=0.1)) - 1.0], dim=-1
        )
        seen = self.vision(images, lengths_px)
        raw = self.ffnn4(torch.cat([seen, self.ffnn3(geometry)], dim=-1))
        shift, spread, tail, rss_mean, rss_slope, rss_spread = raw.unbind(-1)
        return MeasurementDistribution(
            shift=shift,
            spread=softplus(spread) + SMALLEST_SPREAD,
            tail=softplus(tail) + SMALLEST_SPREAD,
            rss_mean=RSS_CENTRE_DBM + RSS_SCALE_DB * rss_mean,
            rss_slope=rss_slope,
            rss_spread=RSS_SCALE_DB * softplus(rss_spread) + SMALLEST_SPREAD,
        )
