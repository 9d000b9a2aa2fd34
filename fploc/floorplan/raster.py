"""A plan as tensors, and how networks look at it: resolution and extent of their crops."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from fploc.floorplan.augmentation import Distortions
from fploc.floorplan.crop import Crops, crop_softened_links, ink_of, soften_for
from fploc.floorplan.plan import FloorPlan


@dataclass(frozen=True)
class PlanRaster:
    """A floor plan as tensors.

    Args:
        ink: Shape (H, W), 1 where a line is drawn, 0 where free.
        pixels_from_metres: Metres of the site frame to pixels of ``ink``, shape (2, 3).
    """

    ink: Tensor
    pixels_from_metres: Tensor
    _softened: dict[float, PlanRaster] = field(default_factory=dict, init=False, repr=False, compare=False)
    _moved: dict[torch.device, PlanRaster] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, plan: FloorPlan) -> PlanRaster:
        """Return the raster of ``plan``."""
        matrix = torch.tensor(plan.georeference.pixels_from_metres, dtype=torch.float32)
        return cls(ink=ink_of(plan), pixels_from_metres=matrix)

    def to(self, device: torch.device | str) -> PlanRaster:
        """Return the raster on ``device``, itself where it is there already: copied once, since every batch asks."""
        device = torch.device(device)
        if self.ink.device == device:
            return self
        if device not in self._moved:
            self._moved[device] = PlanRaster(self.ink.to(device), self.pixels_from_metres.to(device))
        return self._moved[device]

    def softened(self, pixels_per_metre: float) -> PlanRaster:
        """Return the raster softened for crops of a resolution: done once, since every batch asks for it."""
        if pixels_per_metre not in self._softened:
            ink = soften_for(self.ink, self.pixels_from_metres, pixels_per_metre)
            self._softened[pixels_per_metre] = PlanRaster(ink, self.pixels_from_metres)
        return self._softened[pixels_per_metre]


@dataclass(frozen=True)
class CropSettings:
    """Resolution and extent of crops; fixed with a network, so it travels in its artifact.

    Args:
        pixels_per_metre: The paper's is 64.
        width_m: Extent across the link; the paper's is 4 m.
        max_length_px: Longest crop; links beyond it are cut at the device's end.
        patch_length_px: A batch is padded to a multiple of it.
    """

    pixels_per_metre: float
    width_m: float
    max_length_px: int
    patch_length_px: int

    @property
    def largest_px(self) -> int:
        """Pixels of the longest crop."""
        return round(self.width_m * self.pixels_per_metre) * self.max_length_px

    def softened(self, plan: PlanRaster) -> PlanRaster:
        """Return ``plan`` prepared for ``crop_softened``."""
        return plan.softened(self.pixels_per_metre)

    def crop(
        self, plan: PlanRaster, starts: Tensor, ends: Tensor, distortions: Distortions | None = None
    ) -> Crops:
        """Crop links from ``starts`` to ``ends``, (L, 2) metres, padded to the longest of the batch."""
        return self.crop_softened(self.softened(plan), starts, ends, distortions)

    def crop_softened(
        self, plan: PlanRaster, starts: Tensor, ends: Tensor, distortions: Distortions | None = None
    ) -> Crops:
        """Crop links of a plan that ``softened`` has prepared."""
        longest_m = float((ends - starts).norm(dim=-1).max()) if len(starts) else 0.0
        patches = math.ceil((longest_m * self.pixels_per_metre + 1) / self.patch_length_px)
        return crop_softened_links(
            plan.ink,
            plan.pixels_from_metres,
            starts,
            ends,
            pixels_per_metre=self.pixels_per_metre,
            width_m=self.width_m,
            length_px=min(patches * self.patch_length_px, self.max_length_px),
            distortions=distortions,
        )
