"""Where somebody can walk on a plan."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import AP_COLOUR, colour
from fploc.plots.plan_axes import draw_plan
from fploc.plots.results import MADE_UP
from fploc.sites.site import Site

WIDTH_IN = 8.0
VIEW_MARGIN_M = 5.0
OPACITY = 0.45


def plot_free_space(plan: FloorPlan, site: Site, free: NDArray[np.bool_], *, title: str) -> Figure:
    """Return the plan with its free cells coloured.

    Args:
        plan: The plan.
        site: For the access points.
        free: True where somebody can walk, the shape of the plan's rasters.
        title: Of the figure.
    """
    low = site.positions_m.min(axis=0) - VIEW_MARGIN_M
    high = site.positions_m.max(axis=0) + VIEW_MARGIN_M
    height_in = WIDTH_IN * (high - low)[1] / (high - low)[0]
    figure = Figure(figsize=(WIDTH_IN, height_in + 1.2), layout="constrained")
    axes = figure.subplots()
    draw_plan(axes, plan, opacity=1.0)
    (left, right), (bottom, top) = axes.images[0].get_extent()[:2], axes.images[0].get_extent()[2:]
    axes.imshow(
        np.ma.masked_equal(free, False), cmap="cool", vmin=0, vmax=1, alpha=OPACITY,
        extent=(left, right, bottom, top), interpolation="none",
    )  # fmt: skip
    axes.plot(
        *site.positions_m.T, "*", color=AP_COLOUR, markersize=10, label="access points", linestyle="none"
    )
    axes.fill([], [], color=colour(3), alpha=OPACITY, label="free space")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(f"{title} ({MADE_UP})" if site.made_up else title)
    figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    return figure
