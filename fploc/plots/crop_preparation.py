"""How a crop comes about: a strip of the plan from access point to coarse position, turned level."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike, NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import CropSettings, PlanRaster
from fploc.plots.palette import AP_COLOUR
from fploc.plots.plan_axes import draw_plan
from fploc.plots.results import MADE_UP
from fploc.sites.site import Site

VIEW_MARGIN_M = 3.0
STRIP_COLOUR = "#0072B2"
DEVICE_COLOUR = "#E69F00"
LARGEST_HEIGHT_IN = 5.5
WIDTH_IN = 8.0


def strip_corners(start_m: ArrayLike, end_m: ArrayLike, width_m: float) -> NDArray[np.float64]:
    """Return the corners of the strip that is cropped, shape (4, 2), metres, in the order of the crop's own:
    lower left, lower right, upper right, upper left, with the start on the left.
    """
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    forward = (end - start) / np.linalg.norm(end - start)
    aside = 0.5 * width_m * np.array([-forward[1], forward[0]])
    return np.stack([start - aside, end - aside, end + aside, start + aside])


def plot_crop_preparation(
    plan: FloorPlan, site: Site, access_point: int, coarse_m: ArrayLike, crops: CropSettings, *, title: str
) -> Figure:
    """Return the plan with the strip of one link, and below it the crop that networks see (paper, f_IG).

    Args:
        plan: The plan.
        site: Its access points.
        access_point: Index of the link's own.
        coarse_m: Coarse position of the device, shape (2,), metres, elsewhere than the access point.
        crops: Resolution and extent of the crop.
        title: Of the figure.
    """
    start, end = site.positions_m[access_point], np.asarray(coarse_m, dtype=np.float64)
    corners = strip_corners(start, end, crops.width_m)
    seen = np.concatenate([site.positions_m, corners])
    low, high = seen.min(axis=0) - VIEW_MARGIN_M, seen.max(axis=0) + VIEW_MARGIN_M
    tall_in = min(LARGEST_HEIGHT_IN, WIDTH_IN * (high - low)[1] / (high - low)[0])
    ends = torch.tensor(np.stack([start, end]), dtype=torch.float32)
    crop = crops.crop(PlanRaster.of(plan), ends[:1], ends[1:])
    columns = int(crop.lengths_px[0])
    length_m = columns / crops.pixels_per_metre
    strip_in = min(0.6 * tall_in, WIDTH_IN * crops.width_m / length_m)
    figure = Figure(figsize=(WIDTH_IN, tall_in + strip_in + 2.0), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[tall_in, strip_in])

    draw_plan(above, plan)
    above.add_patch(Polygon(corners, facecolor=STRIP_COLOUR, alpha=0.15))
    above.add_patch(Polygon(corners, fill=False, edgecolor=STRIP_COLOUR, linewidth=1.6))
    above.plot(*np.stack([start, end]).T, "--", color=STRIP_COLOUR, linewidth=1.0)
    others = np.delete(site.positions_m, access_point, axis=0)
    above.plot(*others.T, "*", color=AP_COLOUR, markersize=7, alpha=0.35, label="other access points")
    name = site.access_points[access_point].name
    above.plot(*start, "*", color=AP_COLOUR, markersize=13, markeredgecolor="white", label=name)
    above.plot(*end, "o", color=DEVICE_COLOUR, markersize=9, markeredgecolor="white", label="coarse position")
    above.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    above.set_title(f"{title} ({MADE_UP})" if site.made_up else title)

    half = crops.width_m / 2
    below.imshow(
        crop.images[0, 0, :, :columns].numpy(),
        cmap="gray_r",
        vmin=0,
        vmax=1,
        extent=(0.0, length_m, -half, half),
        interpolation="none",
    )
    below.plot(0.0, 0.0, "*", color=AP_COLOUR, markersize=13, markeredgecolor="white", clip_on=False)
    below.plot(
        float(np.linalg.norm(end - start)), 0.0, "o",
        color=DEVICE_COLOUR, markersize=9, markeredgecolor="white", clip_on=False,
    )  # fmt: skip
    below.set(xlim=(0.0, length_m), ylim=(-half, half), aspect="equal")
    below.set(xlabel="along the link [m]", ylabel="across [m]")
    below.set_title(
        f"crop: {crop.images.shape[2]} × {columns} pixels, {crops.pixels_per_metre:g} px/m", fontsize=10
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return figure
