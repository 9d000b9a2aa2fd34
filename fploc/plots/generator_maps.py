"""Maps of what the generator expects of each access point, and of how far measurements are from it."""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.grid import PlaceGrid
from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import AP_COLOUR
from fploc.plots.plan_axes import draw_plan
from fploc.plots.results import MADE_UP
from fploc.sites.site import Site

Floats = NDArray[np.float64]

PANEL_IN = 4.2
VIEW_MARGIN_M = 1.5
# Values beyond these percentiles take the colour of the end of the scale.
SHOWN_PERCENTILES = (1.0, 99.0)
SMALLEST_LIMIT = 1e-3


def shown_limits(values: Floats) -> tuple[float, float]:
    """Return the 1st and 99th percentile of the known ``values``; 0 and 1 where none is known."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, SHOWN_PERCENTILES)
    return float(low), float(max(high, low + SMALLEST_LIMIT))


def centred_limits(values: Floats) -> tuple[float, float]:
    """Return limits around 0 that hold ``shown_limits``."""
    reach = max(abs(limit) for limit in shown_limits(values))
    return -reach, reach


def plot_generator_maps(
    plan: FloorPlan,
    site: Site,
    grid: PlaceGrid,
    values: Floats,
    *,
    title: str,
    label: str,
    colours: str,
    limits: tuple[float, float],
) -> Figure:
    """Return a map for each access point, the plan underneath (paper, figure "Synthetic data generator").

    Args:
        plan: The plan.
        site: Its access points: a star marks the one that a panel is about.
        grid: Where the values belong.
        values: Shape (A, rows, columns); NaN where there is none.
        title: Of the figure.
        label: Of the colour bar, with the unit.
        colours: Name of matplotlib's colour map.
        limits: Values at the ends of the colours.
    """
    left, right, bottom, top = grid.extent_m
    corners = np.concatenate([site.positions_m, [[left, bottom], [right, top]]])
    low, high = corners.min(axis=0) - VIEW_MARGIN_M, corners.max(axis=0) + VIEW_MARGIN_M
    aspect = (high - low)[1] / (high - low)[0]
    number = len(site.access_points)
    columns = min(number, max(1, round(sqrt(1.4 * number * aspect))))
    rows = ceil(number / columns)
    figure = Figure(
        figsize=(PANEL_IN * columns + 1.8, (PANEL_IN * aspect + 0.35) * rows + 0.8), layout="constrained"
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for unused in panels[number:]:
        unused.remove()
    for axes, access_point, of_one in zip(panels, site.access_points, values, strict=False):
        draw_plan(axes, plan)
        image = axes.imshow(
            np.ma.masked_invalid(of_one),
            cmap=colours,
            vmin=limits[0],
            vmax=limits[1],
            extent=grid.extent_m,
            origin="lower",
            interpolation="none",
            zorder=1,
        )
        axes.plot(
            access_point.x_m, access_point.y_m, "*",
            color=AP_COLOUR, markeredgecolor="white", markersize=14, zorder=3,
        )  # fmt: skip
        heard = np.isfinite(of_one).any()
        axes.set_title(access_point.name if heard else f"{access_point.name}: nothing here", fontsize=10)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    figure.supxlabel("x [m]")
    figure.supylabel("y [m]")
    figure.colorbar(image, ax=list(panels[:number]), label=label, extend="both", fraction=0.04, aspect=35)
    figure.suptitle(f"{title} ({MADE_UP})" if site.made_up else title)
    return figure
