"""Walls: from a native plan image to rasters in the site frame, and geometry on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fploc.errors import FplocError
from fploc.floorplan.georeference import Floats, Georeference
from fploc.floorplan.plan import FloorPlan, Grey, Mask, read_grey_image

# Darker than this is drawn line. Hairlines of soft JPEGs reach only 60–200 once area-averaged.
_LINE_BELOW = 200
_FREE = 255
# Fixed-point digits of polygon corners for cv2.fillPoly: sixteenths of a pixel.
_POLYGON_SHIFT = 4
# Samples along links held in memory at once (8 bytes of index and 1 of wall each, a few times over).
_SAMPLES_AT_ONCE = 1 << 20
# Links are sampled every half pixel: no wall of one pixel is stepped over, not even at a corner's edge.
_STEP_PX = 0.5
# A seed (an access point hangs on a wall) stands for free cells no farther than this from it.
_SEED_REACH_M = 1.5
# Nothing of this width gets into a building: doors, gates and gaps of a drawing are narrower.
_WIDEST_ENTRANCE_M = 3.0


@dataclass(frozen=True, eq=False)
class WallCrossings:
    """What lies on straight links through a plan.

    Args:
        count: Number of separate walls met, shape (L,).
        thickness_m: Length of the link inside walls, shape (L,), metres.
    """

    count: NDArray[np.int64]
    thickness_m: Floats


def render_plan(
    image_path: Path,
    *,
    native_from_metres: Georeference,
    origin_m: ArrayLike,
    size_px: tuple[int, int],
    not_walls_m: Sequence[ArrayLike],
    blank_boxes_px: Sequence[Sequence[int]],
    metres_per_pixel: float = 0.05,
    thinnest_wall_m: float = 0.0,
    name: str | None = None,
) -> FloorPlan:
    """Render a plan image into the site frame: columns along x, rows down along −y, area-averaged.

    Args:
        image_path: The plan as published, any scale and turn.
        native_from_metres: Metres of the site frame to pixels of that image.
        origin_m: Outer corner of the top-left pixel of the result, shape (2,), metres.
        size_px: Width and height of the result, pixels.
        not_walls_m: Polygons, each (corners, 2), metres, whose lines are no walls (stairs, furniture);
            they stay in the drawing.
        blank_boxes_px: Boxes x0, y0, x1, y1 in native pixels to blank (scale bar, text).
        metres_per_pixel: Side of a pixel of the result.
        thinnest_wall_m: Lines thinner than this are no walls (parking bays); 0 keeps every line.
        name: Name of the plan; the image's stem where none is given.

    Raises:
        MissingFileError: If there is no such image.
        BadFileError: If it is no image.
        FplocError: If a polygon or box has the wrong shape, or the plan misses the image.
    """
    native = read_grey_image(image_path)
    for box in blank_boxes_px:
        left, top, right, bottom = _checked_box(box, image_path)
        native[top:bottom, left:right] = _FREE
    georeference = Georeference.of_raster(origin_m, metres_per_pixel)
    grey = _resample(native, native_from_metres, origin_m, size_px, metres_per_pixel, image_path)
    lines = grey < _LINE_BELOW
    if thinnest_wall_m > metres_per_pixel:
        side = round(thinnest_wall_m / metres_per_pixel)
        kernel = np.ones((side, side), np.uint8)
        lines = cv2.morphologyEx(lines.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0
    walls = lines & ~_inside(not_walls_m, georeference, lines.shape)
    return FloorPlan(
        name=image_path.stem if name is None else name, grey=grey, walls=walls, georeference=georeference
    )


def wall_crossings(plan: FloorPlan, starts_m: ArrayLike, ends_m: ArrayLike) -> WallCrossings:
    """Count the walls between pairs of points and measure their thickness along the link.

    Sampled at half-pixel steps; a sample belongs to the pixel that it lies in. Outside the plan is free.

    Args:
        plan: The plan.
        starts_m: Shape (L, 2), metres, site frame.
        ends_m: Shape (L, 2), metres, site frame.
    """
    starts = np.asarray(starts_m, dtype=np.float64).reshape(-1, 2)
    ends = np.asarray(ends_m, dtype=np.float64).reshape(-1, 2)
    count = np.zeros(len(starts), dtype=np.int64)
    thickness = np.zeros(len(starts))
    lengths_m = np.linalg.norm(ends - starts, axis=1)
    for links, in_wall, present in _sampled(plan, starts, ends):
        inside = in_wall & present
        entered = inside.copy()
        entered[:, 1:] &= ~inside[:, :-1]
        count[links] = entered.sum(axis=1)
        thickness[links] = inside.sum(axis=1) / present.sum(axis=1) * lengths_m[links]
    return WallCrossings(count=count, thickness_m=thickness)


def line_of_sight(
    plan: FloorPlan, starts_m: ArrayLike, ends_m: ArrayLike, *, end_margin_m: float = 0.0
) -> NDArray[np.bool_]:
    """Return where the straight link meets no wall, shape (L,).

    Args:
        plan: The plan.
        starts_m: Shape (L, 2), metres, site frame.
        ends_m: Shape (L, 2), metres, site frame.
        end_margin_m: Walls this close to either end do not count: access points hang on walls.
    """
    starts = np.asarray(starts_m, dtype=np.float64).reshape(-1, 2)
    ends = np.asarray(ends_m, dtype=np.float64).reshape(-1, 2)
    length = np.linalg.norm(ends - starts, axis=1, keepdims=True)
    cut = np.minimum(end_margin_m, length / 2) / np.maximum(length, np.finfo(np.float64).tiny)
    inner = (starts + cut * (ends - starts), ends + cut * (starts - ends))
    free: NDArray[np.bool_] = wall_crossings(plan, *inner).count == 0
    return free


def free_space(
    plan: FloorPlan, seeds_m: ArrayLike, *, clearance_m: float = 0.3, margin_m: float = 8.0
) -> Mask:
    """Return the cells that a walker can reach, shape (H, W).

    Cells at least ``clearance_m`` from every wall, connected to the cell nearest to some access point,
    indoors, inside the access points' bounding box widened by ``margin_m``. Outdoors is what something
    3 m wide can reach from beyond the plan: entrances and gaps of the drawing are narrower. Where most
    access points stand outdoors by that rule (the drawing does not enclose the building, or the plan
    cuts through it), outdoors counts as well, as far as the bounding box goes.

    Args:
        plan: The plan.
        seeds_m: Where a walker may start, for example the access points, shape (A, 2), metres.
        clearance_m: Least distance from a wall.
        margin_m: How far beyond the seeds' bounding box cells may lie.

    Raises:
        FplocError: If no cell is free near any seed.
    """
    seeds = np.asarray(seeds_m, dtype=np.float64).reshape(-1, 2)
    distance_m = _distance_from(plan.walls, plan.georeference)
    clear = distance_m >= clearance_m
    outdoors = _outdoors(plan)
    # 0 wall or too close to one, 1 indoors, 2 outdoors: what the free cell nearest to each seed is.
    kinds = _nearest_values(seeds, np.where(clear, 1 + outdoors.astype(np.int32), 0), plan.georeference)
    enclosed = np.count_nonzero(kinds == 1) >= np.count_nonzero(kinds == 2)
    cells = clear & ~outdoors if enclosed else clear
    regions = np.asarray(cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)[1], dtype=np.int32)
    wanted = np.setdiff1d(_nearest_values(seeds, regions, plan.georeference), [0])
    if not wanted.size:
        raise FplocError(
            f"free space of the plan {plan.name}",
            value=f"no cell {clearance_m} m from walls within {_SEED_REACH_M} m of any of {len(seeds)} seeds",
            expected="access points beside floor that can be walked on",
            way_out="check the georeference and the walls, or ask for less clearance",
        )
    height, width = plan.walls.shape
    cells_m = plan.georeference.to_metres(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1))
    low, high = seeds.min(axis=0) - margin_m, seeds.max(axis=0) + margin_m
    in_box = ((cells_m >= low) & (cells_m <= high)).all(axis=-1)
    reachable: Mask = np.isin(regions, wanted) & in_box
    return reachable


def _resample(
    native: Grey,
    native_from_metres: Georeference,
    origin_m: ArrayLike,
    size_px: tuple[int, int],
    metres_per_pixel: float,
    image_path: Path,
) -> Grey:
    """Warp to a raster at least as fine as the image, then average areas down to the one asked for."""
    width, height = size_px
    finer = max(1, int(np.ceil(native_from_metres.pixels_per_metre * metres_per_pixel)))
    fine = Georeference.of_raster(origin_m, metres_per_pixel / finer)
    native_from_fine = np.vstack([native_from_metres.pixels_from_metres, [0, 0, 1]]) @ np.vstack(
        [fine.metres_from_pixels, [0, 0, 1]]
    )
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) * finer
    reached = corners @ native_from_fine[:2, :2].T + native_from_fine[:2, 2]
    rows, columns = native.shape
    if (reached.max(axis=0) < 0).any() or (reached.min(axis=0) > [columns, rows]).any():
        raise FplocError(
            f"{image_path}, georeference",
            value=f"a plan that covers pixels {reached.min(axis=0).round().tolist()} "
            f"to {reached.max(axis=0).round().tolist()}",
            expected=f"pixels inside the image, {columns} x {rows}",
            way_out="check the matrix, the plan's origin and the image file",
        )
    warped = cv2.warpAffine(
        native,
        native_from_fine[:2],
        (width * finer, height * finer),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=_FREE,
    )
    return np.asarray(cv2.resize(warped, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _checked_box(box: Sequence[int], image_path: Path) -> tuple[int, int, int, int]:
    values = [int(value) for value in box]
    if len(values) != 4 or values[0] >= values[2] or values[1] >= values[3] or min(values) < 0:
        raise FplocError(
            f"box to blank in {image_path}",
            value=values,
            expected="x0, y0, x1, y1 in pixels with x0 < x1 and y0 < y1",
            way_out="correct `blank_boxes_px` in the site's file",
        )
    return values[0], values[1], values[2], values[3]


def _inside(polygons_m: Sequence[ArrayLike], georeference: Georeference, shape: tuple[int, ...]) -> Mask:
    """Return the cells inside any of the polygons."""
    mask = np.zeros(shape, dtype=np.uint8)
    for number, polygon in enumerate(polygons_m, start=1):
        corners = np.asarray(polygon, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise FplocError(
                f"polygon {number} of areas that are no walls",
                value=f"an array of shape {corners.shape}",
                expected="at least 3 corners of 2 numbers each, metres",
                way_out="correct `not_walls_m` in the site's file",
            )
        fixed = np.round(georeference.to_pixels(corners) * 2**_POLYGON_SHIFT).astype(np.int32)
        cv2.fillPoly(mask, [fixed], 1, shift=_POLYGON_SHIFT)
    inside: Mask = mask > 0
    return inside


def _sampled(plan: FloorPlan, starts: Floats, ends: Floats) -> Iterator[tuple[NDArray[np.int64], Mask, Mask]]:
    """Yield chunks of links of like length: their indices, samples in walls, samples that exist."""
    height, width = plan.walls.shape
    # One free pixel all round stands for everything outside the plan.
    padded = np.pad(plan.walls, 1).ravel()
    first, last = plan.georeference.to_pixels(starts), plan.georeference.to_pixels(ends)
    samples = np.maximum(np.ceil(np.linalg.norm(last - first, axis=1) / _STEP_PX), 1).astype(np.int64)
    order = np.argsort(samples, kind="stable")
    begin = 0
    while begin < len(order):
        # Links are sorted: the longest of a chunk is its last, so the cost of a chunk grows with its size.
        sizes = samples[order[begin:]] * np.arange(1, len(order) - begin + 1)
        stop = begin + max(1, int(np.searchsorted(sizes, _SAMPLES_AT_ONCE, side="right")))
        links = order[begin:stop]
        begin = stop
        number = samples[links][:, None]
        index = np.arange(number.max())
        along = (index + 0.5) / number
        u = first[links, :1] + along * (last[links, :1] - first[links, :1])
        v = first[links, 1:] + along * (last[links, 1:] - first[links, 1:])
        column = np.clip(np.floor(u + 1.5), 0, width + 1).astype(np.int64)
        row = np.clip(np.floor(v + 1.5), 0, height + 1).astype(np.int64)
        yield links, padded[row * (width + 2) + column], index < number


def _distance_from(cells: Mask, georeference: Georeference) -> Floats:
    """Return the distance of every cell's centre from the face of the nearest of ``cells``, metres."""
    distance_px = cv2.distanceTransform((~cells).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # The nearest cell's centre is half a pixel behind its face.
    return (np.asarray(distance_px, dtype=np.float64) - 0.5) / georeference.pixels_per_metre


def _outdoors(plan: FloorPlan) -> Mask:
    """Return what a disc as wide as ``_WIDEST_ENTRANCE_M`` can cover coming from beyond the plan."""
    radius_m = _WIDEST_ENTRANCE_M / 2
    # Free ground all round the plan, wide enough for the disc.
    around = int(np.ceil(_WIDEST_ENTRANCE_M * plan.georeference.pixels_per_metre)) + 1
    walls: Mask = np.pad(plan.walls, around)
    centres = _distance_from(walls, plan.georeference) >= radius_m
    regions = cv2.connectedComponents(centres.astype(np.uint8), connectivity=4)[1]
    labels = np.asarray(regions, dtype=np.int32)
    beyond: Mask = labels == labels[0, 0]
    to_beyond = _distance_from(beyond, plan.georeference)[around:-around, around:-around]
    covered: Mask = to_beyond < radius_m
    return covered


def _nearest_values(
    seeds: Floats, values: NDArray[np.int32], georeference: Georeference
) -> NDArray[np.int32]:
    """Return the value of the nearest cell that is not 0 to each seed, shape (A,); 0 where none is near."""
    height, width = values.shape
    reach_px = _SEED_REACH_M * georeference.pixels_per_metre
    span = np.arange(-int(reach_px), int(reach_px) + 1)
    offsets = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(offsets, axis=1)
    offsets = offsets[np.argsort(distance, kind="stable")][: np.count_nonzero(distance <= reach_px)]
    places = np.round(georeference.to_pixels(seeds)).astype(np.int64)[:, None] + offsets
    inside = np.asarray(((places >= 0) & (places < [width, height])).all(axis=-1), dtype=np.bool_)
    column, row = np.where(inside[..., None], places, 0).transpose(2, 0, 1)
    found = np.where(inside, values[row, column], 0)
    nearest: NDArray[np.int32] = found[np.arange(len(found)), (found != 0).argmax(axis=1)]
    return nearest
