"""A site at a glance: plan, walls, access points and where the devices went."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import colour as colour_of
from fploc.sites.site import Site

_WALL_COLOUR = "#222222"
_LINE_COLOUR = "#9a9a9a"
_AP_COLOUR = "#B22222"
_VIEW_MARGIN_M = 5.0
_SCALE_BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_LARGEST_SIDE_IN = 11.0


def plot_site_overlay(plan: FloorPlan, site: Site, paths: Mapping[str, NDArray[np.float64]]) -> Figure:
    """Draw a plan with its access points and paths, in metres, x right and y up.

    Walls are black, lines of the drawing that are no walls are grey. The view is the surroundings of the
    access points and paths.

    Args:
        plan: The plan in the frame of the site, columns along x.
        site: The site.
        paths: Label → positions, each (T, 2), metres; rows with NaN are left out; a path may be empty.
    """
    known = {label: path[np.isfinite(path).all(axis=-1)] for label, path in paths.items()}
    places = np.concatenate([site.positions_m, *known.values()])
    edges = _edges(plan)
    low = np.maximum(places.min(axis=0) - _VIEW_MARGIN_M, edges[[0, 2]])
    high = np.minimum(places.max(axis=0) + _VIEW_MARGIN_M, edges[[1, 3]])
    low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
    scale = _LARGEST_SIDE_IN / (high - low).max()
    figure = Figure(
        figsize=((high - low)[0] * scale + 2.2, (high - low)[1] * scale + 1.0), layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(_coloured(plan), extent=tuple(edges), origin="upper", interpolation="antialiased")
    # The first is the widest: of paths on one line, each still shows at the rims of the next.
    widths = np.linspace(1.4 * max(len(known), 1), 1.4, len(known))
    for (label, path), colour, width in zip(
        known.items(), map(colour_of, range(len(known))), widths, strict=True
    ):
        axes.plot(*path.T, color=colour, linewidth=width, alpha=0.85, label=label, zorder=3)
        if len(path):
            axes.plot(*path[0], marker="o", color=colour, markeredgecolor="white", markersize=7, zorder=4)
    axes.plot(
        *site.positions_m.T, linestyle="none", marker="^", markersize=10, color=_AP_COLOUR,
        markeredgecolor="white", label="access point", zorder=5,
    )  # fmt: skip
    halo = [patheffects.withStroke(linewidth=2.5, foreground="white")]
    for ap in site.access_points:
        axes.annotate(
            ap.name, (ap.x_m, ap.y_m), xytext=(0, 8), textcoords="offset points", ha="center", va="bottom",
            fontsize=9, fontweight="bold", color=_AP_COLOUR, path_effects=halo, zorder=6, annotation_clip=True,
        )  # fmt: skip
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(
        f"{site.name} (made-up building: nothing here was measured)" if site.made_up else site.name
    )
    _add_scale_bar(axes, low, high)
    figure.legend(loc="outside right upper", frameon=False, title="circle: start")
    return figure


def _edges(plan: FloorPlan) -> NDArray[np.float64]:
    """Return left, right, bottom and top of the raster, metres."""
    height, width = plan.grey.shape
    corners = plan.georeference.to_metres([[-0.5, height - 0.5], [width - 0.5, -0.5]])
    return corners.T.ravel()


def _coloured(plan: FloorPlan) -> NDArray[np.float64]:
    """Return the plan as colours, shape (H, W, 3): walls dark, other lines pale, paper white."""
    ink = 1.0 - plan.grey[..., None] / 255.0
    pale = 1.0 - ink * (1.0 - np.array(to_rgb(_LINE_COLOUR)))
    return np.where(plan.walls[..., None], np.array(to_rgb(_WALL_COLOUR)), pale)


def _add_scale_bar(axes: Axes, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Draw a bar of a round length, about a sixth of the view, in the lower left corner."""
    length = min(_SCALE_BARS_M, key=lambda bar: abs(bar - (high - low)[0] / 6))
    left, bottom = low + 0.03 * (high - low).max()
    halo = [patheffects.withStroke(linewidth=5, foreground="white")]
    axes.plot(
        [left, left + length], [bottom, bottom], color="black", linewidth=3, solid_capstyle="butt",
        path_effects=halo, zorder=7,
    )  # fmt: skip
    axes.annotate(
        f"{length:g} m", (left + length / 2, bottom), xytext=(0, 4), textcoords="offset points", ha="center",
        path_effects=halo, zorder=7,
    )  # fmt: skip
