"""The paper's image generator f_IG: per link, the plan between access point and device, turned level."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from fploc.floorplan.augmentation import Distortions
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
    return _box_filter(_box_filter(ink, pixels, dim=0), pixels, dim=1)


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
    return crop_softened_links(
        soften_for(ink, pixels_from_metres, pixels_per_metre),
        pixels_from_metres,
        starts,
        ends,
        pixels_per_metre=pixels_per_metre,
        width_m=width_m,
        length_px=length_px,
    )


def soften_for(ink: Tensor, pixels_from_metres: Tensor, pixels_per_metre: float) -> Tensor:
    """Return a plan, shape (H, W), softened for crops of ``pixels_per_metre``; unchanged where these are finer."""
    plan_pixels_per_metre = pixels_from_metres[:, :2].det().abs().sqrt()
    return soften(ink, float(plan_pixels_per_metre) / pixels_per_metre)


def crop_softened_links(
    softened: Tensor,
    pixels_from_metres: Tensor,
    starts: Tensor,
    ends: Tensor,
    *,
    pixels_per_metre: float,
    width_m: float = 4.0,
    length_px: int,
    distortions: Distortions | None = None,
) -> Crops:
    """Crop a plan that ``soften_for`` has prepared once; otherwise as ``crop_links``.

    ``distortions`` of the links, if any, change what their crops show, not how long these are.
    """
    device, dtype = softened.device, softened.dtype
    matrix = pixels_from_metres.to(device, dtype)
    starts, ends = starts.to(device, dtype), ends.to(device, dtype)
    height = max(1, round(width_m * pixels_per_metre))

    along = ends - starts
    distance = along.norm(dim=1, keepdim=True)
    level = torch.tensor([1.0, 0.0], device=device, dtype=dtype)
    forward = torch.where(distance > _SHORTEST_M, along / distance.clamp_min(_SHORTEST_M), level)
    left = torch.stack([-forward[:, 1], forward[:, 0]], dim=1)
    lengths = (distance[:, 0] * pixels_per_metre).round().long().clamp(1, length_px)
    if distortions is not None:
        starts, forward, left = distortions.moved(starts, forward, left)

    columns = torch.arange(length_px, device=device)
    belongs = columns < lengths[:, None]
    link, column = belongs.nonzero(as_tuple=True)
    ahead_m = (column + 0.5) / pixels_per_metre
    aside_m = ((height - 1) / 2 - torch.arange(height, device=device, dtype=dtype)) / pixels_per_metre

    # In units of grid_sample: −1 and 1 are the outer edges of the plan. No matrix product: mixed precision
    # and reduced-precision products would move the crop by pixels.
    size = torch.tensor([softened.shape[1], softened.shape[0]], device=device, dtype=dtype)
    linear, shift = matrix[:, :2] * 2 / size[:, None], (2 * matrix[:, 2] + 1) / size - 1
    start, step, turn = (_apply(linear, vectors) for vectors in (starts, forward, left))
    middle = (start + shift)[link] + ahead_m[:, None] * step[link]
    # A complex number is a place (u, v): the sum then runs over rows at full width, not over pairs.
    aside = torch.view_as_complex(turn)[link, None] * aside_m
    grid = torch.view_as_real(torch.view_as_complex(middle)[:, None] + aside)
    sampled = grid_sample(
        softened[None, None],
        grid[None],
        mode="bilinear",
        padding_mode="zeros",
        align_corners=False,
    )
    drawn = sampled[0, 0]
    if distortions is not None:
        drawn = (drawn * distortions.line_weight[link, None]).clamp(max=1.0)
    images = torch.zeros(len(starts), height, length_px, device=device, dtype=dtype)
    images.transpose(1, 2)[link, column] = drawn
    return Crops(images=images[:, None], lengths_px=lengths)


def _apply(linear: Tensor, vectors: Tensor) -> Tensor:
    """Return a (2, 2) map applied to vectors (L, 2) at full precision."""
    return (linear * vectors[:, None]).sum(dim=-1)


def _box_filter(ink: Tensor, pixels: float, *, dim: int) -> Tensor:
    """Average over ``pixels`` pixels along one dimension; the outermost two count in part."""
    reach = ceil((pixels - 1.0) / 2)
    edge = (pixels - (2 * reach - 1)) / 2
    padding = [0, 0, reach, reach] if dim == 0 else [reach, reach, 0, 0]
    padded, size = pad(ink, padding), ink.shape[dim]
    total = (padded.narrow(dim, 0, size) + padded.narrow(dim, 2 * reach, size)) * edge
    for shift in range(1, 2 * reach):
        total += padded.narrow(dim, shift, size)
    return total / pixels
