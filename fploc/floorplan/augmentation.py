"""Crops that differ from the plan at random, so that a network learns walls and not the places of one plan."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.errors import FplocError


@dataclass(frozen=True, eq=False)
class Distortions:
    """How the crop of each of L links departs from the plan.

    A pixel ``ahead`` metres from the access point along the link and ``aside`` metres to its left shows the
    place ``(ahead + along) / scale`` ahead and ``mirror · (aside + across) / scale`` aside. The length of a
    crop stays that of the link.

    Args:
        mirror: 1 as it is, −1 mirrored across the link's axis, shape (L,).
        along: Shift of the window towards the device, shape (L,), metres.
        across: Shift of the window to the left of the link (to the right where mirrored), shape (L,), metres.
        scale: Size of the drawing over its true size, about the access point, shape (L,).
        line_weight: Factor on the ink, which stays at most 1, shape (L,).
    """

    mirror: Tensor
    along: Tensor
    across: Tensor
    scale: Tensor
    line_weight: Tensor

    def moved(self, starts: Tensor, forward: Tensor, left: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return where windows begin and what a metre of them ahead and to the left is on the plan.

        Args:
            starts: Access points, shape (L, 2), metres.
            forward: Unit vectors along the links, shape (L, 2).
            left: Unit vectors to their left, shape (L, 2).
        """
        ahead = forward / self.scale[:, None]
        aside = left * (self.mirror / self.scale)[:, None]
        return starts + self.along[:, None] * ahead + self.across[:, None] * aside, ahead, aside


@dataclass(frozen=True)
class CropAugmentation:
    """How strongly crops are distorted in training; every link draws its own distortions.

    Args:
        mirror: Probability of a mirrored crop.
        along_m: Largest shift of the window along the link, either way, metres.
        across_m: Largest shift across it, metres.
        scale: Largest departure of the drawing's size from 1, either way.
        line_weight: Largest departure of the factor on the ink from 1.

    Raises:
        FplocError: If a strength lies outside its bounds.
    """

    mirror: float = 0.5
    along_m: float = 0.25
    across_m: float = 0.25
    scale: float = 0.1
    line_weight: float = 0.3

    def __post_init__(self) -> None:
        for name, value, fits, expected in (
            ("mirror", self.mirror, 0.0 <= self.mirror <= 1.0, "0 to 1"),
            ("along_m", self.along_m, self.along_m >= 0.0, "0 or more"),
            ("across_m", self.across_m, self.across_m >= 0.0, "0 or more"),
            ("scale", self.scale, 0.0 <= self.scale < 1.0, "0 to less than 1"),
            ("line_weight", self.line_weight, 0.0 <= self.line_weight <= 1.0, "0 to 1"),
        ):
            if not fits:
                raise FplocError(
                    f"{name} of the augmentation of crops",
                    value=value,
                    expected=expected,
                    way_out=f"correct `{name}`",
                )

    @classmethod
    def none(cls) -> CropAugmentation:
        """Return the augmentation that leaves every crop as it is."""
        return cls(mirror=0.0, along_m=0.0, across_m=0.0, scale=0.0, line_weight=0.0)

    def draw(self, links: int, device: torch.device) -> Distortions:
        """Return distortions of ``links`` links, from torch's own random numbers."""
        mirrored, *uniform = torch.rand(5, links, device=device)
        along, across, scale, line_weight = (2.0 * one - 1.0 for one in uniform)
        return Distortions(
            mirror=torch.where(mirrored < self.mirror, -1.0, 1.0),
            along=self.along_m * along,
            across=self.across_m * across,
            scale=1.0 + self.scale * scale,
            line_weight=1.0 + self.line_weight * line_weight,
        )
