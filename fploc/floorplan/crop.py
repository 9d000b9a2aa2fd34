"""The paper's image generator f_IG: per link, the plan between access point and device, turned level."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import conv2d, grid_sample

from fploc.floorplan.plan import FloorPlan

# Directions of links shorter than this are noise; such a link is drawn as if it pointed along +x.
_SHORTEST_M = 1e-6


@dataclass(frozen=True, eq=False)
class Crops:
    """Crops of a batch of links.

    Args:
        images: Shape (L, 1, H, W), 1 where a line is drawn, 0 where free, outside the plan and past the
            end of the link. The left edge is the start of the link; row 0 is on its left-hand side.
        lengths_px: Number of columns that belong to the link, shape (L,), from 1 to W.
    """

    images: Tensor
    lengths_px: Tensor

    @property
    def mask(self) -> Tensor:
        """True at the columns that belong to the link, shape (L, W)."""
        columns = torch.arange(self.images.shape[-1], device=self.images.device)
        return columns < self.lengths_px[:, None]


def ink_of(plan: FloorPlan) -> Tensor:
    """Return how dark a plan is drawn, shape (H, W), from 0 (free) to 1 (black line)."""
    return 1.0 - torch.from_numpy(plan.grey).to(torch.float32) / 255.0


def soften(ink: Tensor, pixels: float) -> Tensor:
    """Average a drawing over squares of ``pixels`` × ``pixels`` around each pixel, at its own resolution.

    Done before it is read at a coarser spacing: a line of one pixel then shows in some sample whatever
    its place, fainter by as much as it is thinner than the spacing, and the ink along a link stays equal
    to the thickness of what is drawn (a maximum would keep lines black and make them all equally thick).

    Args:
        ink: Shape (H, W).
        pixels: Side of the square; 1 or less changes nothing; need not be whole.
    """
    if pixels <= 1.0:
        return ink
    reach = int(-(-(pixels - 1.0) // 2))
    weights = torch.ones(2 * reach + 1, dtype=ink.dtype, device=ink.device)
    weights[[0, -1]] = (pixels - (2 * reach - 1)) / 2
    weights = weights / pixels
    across = conv2d(ink[None, None], weights[None, None, None, :], padding=(0, reach))
    return conv2d(across, weights[None, None, :, None], padding=(reach, 0))[0, 0]


def crop_links(
    ink: Tensor,
    pixels_from_metres: Tensor,
    starts: Tensor,
    ends: Tensor,
    *,
    pixels_per_metre: float,
    width_m: float = 4.0,
    length_px: int,
) -> Crops:
    """Crop the plan along every link, start left and end right (paper, 'Image Preparation', f_IG).

    A crop is W^(t) columns long, W^(t) the length of the link, and ``width_m`` high. Crops are padded to
    one length and masked, never stretched; links longer than ``length_px`` lose what is beyond it, on the
    side of the device. Only columns that belong to a link are computed. The resolution is the caller's;
    the paper's is 64 px/m. Where it is coarser than the plan's, the plan is softened first (``soften``).

    Args:
        ink: The plan, shape (H, W), 1 where a line is drawn, 0 where free.
        pixels_from_metres: Metres of the site frame to pixels of ``ink``, shape (2, 3).
        starts: Access points, shape (L, 2), metres.
        ends: Coarse positions of the devices, shape (L, 2), metres.
        pixels_per_metre: Resolution of the crops.
        width_m: Extent of the crops across the link.
        length_px: Columns of every crop, W.
    """
    device, dtype = ink.device, ink.dtype
    matrix = pixels_from_metres.to(device, dtype)
    starts, ends = starts.to(device, dtype), ends.to(device, dtype)
    height = max(1, round(width_m * pixels_per_metre))

    along = ends - starts
    distance = along.norm(dim=1, keepdim=True)
    level = torch.tensor([1.0, 0.0], device=device, dtype=dtype)
    forward = torch.where(distance > _SHORTEST_M, along / distance.clamp_min(_SHORTEST_M), level)
    left = torch.stack([-forward[:, 1], forward[:, 0]], dim=1)
    lengths = (distance[:, 0] * pixels_per_metre).round().long().clamp(1, length_px)

    plan_pixels_per_metre = matrix[:, :2].det().abs().sqrt()
    softened = soften(ink, float(plan_pixels_per_metre) / pixels_per_metre)

    columns = torch.arange(length_px, device=device)
    belongs = columns < lengths[:, None]
    link, column = belongs.nonzero(as_tuple=True)
    ahead_m = (column + 0.5) / pixels_per_metre
    aside_m = ((height - 1) / 2 - torch.arange(height, device=device, dtype=dtype)) / pixels_per_metre

    # In units of grid_sample: −1 and 1 are the outer edges of the plan.
    size = torch.tensor([ink.shape[1], ink.shape[0]], device=device, dtype=dtype)
    linear, shift = matrix[:, :2].T * 2 / size, (2 * matrix[:, 2] + 1) / size - 1
    middle = (starts @ linear + shift)[link] + ahead_m[:, None] * (forward @ linear)[link]
    grid = middle[:, None] + aside_m[:, None] * (left @ linear)[link][:, None]
    sampled = grid_sample(
        softened[None, None], grid[None], mode="bilinear", padding_mode="zeros", align_corners=False
    )
    images = torch.zeros(len(starts), length_px, height, device=device, dtype=dtype)
    images[link, column] = sampled[0, 0]
    return Crops(images=images.transpose(1, 2)[:, None].contiguous(), lengths_px=lengths)
