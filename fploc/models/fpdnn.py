"""FPDNN: the distance of a link from its range, its signal strength and the plan between its ends."""

from __future__ import annotations

from enum import IntEnum

import torch
from torch import Tensor, nn

from fploc.errors import UnknownNameError
from fploc.models.deepvit import DeepViT

RANGE_SCALE_M = 10.0
RSS_CENTRE_DBM = -65.0
RSS_SCALE_DB = 10.0
LENGTH_HIDDEN = 16


class Sight(IntEnum):
    """What FPDNN is given of the plan: the crop, its length W alone, or nothing of it."""

    PLAN = 0
    LENGTH = 1
    NOTHING = 2


def normalised_measurement(ranges: Tensor, rss: Tensor) -> Tensor:
    """Return p = (ζ, γ) centred and scaled by fixed constants, shape (B, 2).

    Args:
        ranges: ζ, shape (B,), metres.
        rss: γ, shape (B,), dBm.
    """
    return torch.stack([ranges / RANGE_SCALE_M - 1.0, (rss - RSS_CENTRE_DBM) / RSS_SCALE_DB], dim=-1)


def zero_linear(inputs: int, outputs: int) -> nn.Linear:
    """Return a fully connected layer that puts out zeros until it has learned."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def ffnn(inputs: int, hidden: int, outputs: int, drop: float) -> nn.Sequential:
    """Return two fully connected layers with ReLU, layer norm after the first, dropout after the second.

    Table II of the paper: FFNN1, and FFNN3, which has "the same structure".
    """
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.ReLU(),
        nn.LayerNorm(hidden),
        nn.Linear(hidden, outputs),
        nn.ReLU(),
        nn.Dropout(drop),
    )


class DistanceHead(nn.Module):
    """FFNN2 as published: the bare distance, in units of 10 m inside.

    Table II cannot be built to the letter: its norm maps 32 to 16, which no norm does (here: a norm over 32,
    and a last layer 32 → 1). Its final ReLU is harmless for a distance but passes no gradient where it puts out
    0; softplus is never negative either and always passes one.

    Args:
        features: Width of the concatenated features.
        hidden: Hidden width.
        output: Last layer: ``softplus``, ``relu`` (published) or ``none``, which may put out less than 0.

    Raises:
        UnknownNameError: If there is no such last layer.
    """

    def __init__(self, features: int, hidden: int = 32, output: str = "softplus") -> None:
        super().__init__()
        outputs = {"softplus": nn.Softplus, "relu": nn.ReLU, "none": nn.Identity}
        if output not in outputs:
            raise UnknownNameError(
                "output of DistanceHead", output, known=list(outputs), way_out="correct `output`"
            )
        self.layers = nn.Sequential(
            nn.Linear(features, hidden),
            nn.ReLU(),
            nn.LayerNorm(hidden),
            nn.Linear(hidden, 1),
            outputs[output](),
        )

    def forward(self, features: Tensor, ranges: Tensor) -> Tensor:
        """Return distances (B,) in metres from features (B, F); the ranges (B,) enter as features only."""
        distances: Tensor = self.layers(features)[:, 0] * RANGE_SCALE_M
        return distances.to(ranges.dtype)


class CorrectionHead(nn.Module):
    """A departure from the paper: ζ̂ = ζ − b, so that an unseen length needs no extrapolation of ζ itself."""

    def __init__(self, features: int, hidden: int = 32) -> None:
        super().__init__()
        last = zero_linear(hidden, 1)
        self.layers = nn.Sequential(nn.Linear(features, hidden), nn.ReLU(), nn.LayerNorm(hidden), last)

    def forward(self, features: Tensor, ranges: Tensor) -> Tensor:
        """Return distances (B,) in metres from features (B, F) and ranges ζ (B,) in metres."""
        corrected: Tensor = ranges - self.layers(features)[:, 0]
        return corrected.clamp(min=0.0)


class FPDNN(nn.Module):
    """Floor-plan-aided network: DeepViT on the crop, FFNN1 on (ζ, γ), FFNN2 to the distance.

    Paper: Yu et al., section "Structure of FPDNN", eqs. "FFNN" and "outFPDNN", Table II. Changed: ζ and γ
    are normalised, since metres and dBm differ in size; of the three entries of p, the index of the access
    point is dropped, which means nothing at another site (FFNN1 of Table II takes two as well); links need
    not look at the plan. One set of weights runs with the crop, with its length alone and with
    neither: where a link does not see its crop, a small FFNN of the length or a learned vector stand in for
    DeepViT's features. Trained on all three (``FPDNNTask``), it shows what the plan is worth.

    Args:
        vision: The network on crops.
        head: From the concatenated features and ζ to the distance: ``DistanceHead`` (published) or
            ``CorrectionHead``.
        drop: Dropout rate of FFNN1.

    Shapes:
        - **input:** images (B, 1, H, W), lengths_px (B,), ranges ζ (B,) metres, rss γ (B,) dBm,
          sight (B,) int64, one ``Sight`` per link
        - **output:** distances (B,) metres, in the plan
    """

    def __init__(self, vision: DeepViT, head: nn.Module, drop: float = 0.2) -> None:
        super().__init__()
        self.vision = vision
        self.length_ffnn = ffnn(1, LENGTH_HIDDEN, vision.features, drop=0.0)
        self.nothing = nn.Parameter(torch.zeros(vision.features))
        self.ffnn1 = ffnn(2, 64, 32, drop)
        self.head = head

    def forward(
        self, images: Tensor, lengths_px: Tensor, ranges: Tensor, rss: Tensor, sight: Tensor
    ) -> Tensor:
        """Return the distances of links; see the class for shapes."""
        seen = self.seen(images, lengths_px, sight)
        measured = self.ffnn1(normalised_measurement(ranges, rss))
        distances: Tensor = self.head(torch.cat([seen, measured], dim=-1), ranges)
        return distances

    def seen(self, images: Tensor, lengths_px: Tensor, sight: Tensor) -> Tensor:
        """Return what links know of the plan, shape (B, ``vision.features``); arguments as ``forward``.

        DeepViT runs on the links that look at the plan, and on no other.
        """
        lengths_m = lengths_px / self.vision.crops.pixels_per_metre
        by_length = self.length_ffnn(lengths_m[:, None] / RANGE_SCALE_M - 1.0)
        features = torch.where((sight == Sight.LENGTH)[:, None], by_length, self.nothing)
        (looking,) = torch.nonzero(sight == Sight.PLAN, as_tuple=True)
        if len(looking) == 0:
            return features
        plan = self.vision(images[looking], lengths_px[looking]).to(features.dtype)
        return features.index_copy(0, looking, plan)
