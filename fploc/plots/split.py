"""Which part of the recordings a protocol learns from, leaves out and tests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import AP_COLOUR, colour
from fploc.plots.plan_axes import draw_plan
from fploc.plots.results import MADE_UP
from fploc.sites.site import Site

Floats = NDArray[np.float64]

WIDTH_IN = 8.0
VIEW_MARGIN_M = 3.0
NARROWEST, STEP = 2.0, 2.5
"""Line widths in points: recordings of one line still show at the rims of those drawn over them."""


def plot_split(plan: FloorPlan, site: Site, parts_m: Mapping[str, Sequence[Floats]], *, title: str) -> Figure:
    """Return the paths of every part on the plan, the first part widest.

    Args:
        plan: The plan.
        site: For the access points.
        parts_m: Paths by what they are used for; each of shape (T, 2), metres, site frame; NaN where a
            recording does not belong to the part. A part may be empty.
        title: Of the figure.
    """
    paths = [path for part in parts_m.values() for path in part]
    seen = np.concatenate([site.positions_m, *(path[np.isfinite(path).all(axis=1)] for path in paths)])
    low, high = seen.min(axis=0) - VIEW_MARGIN_M, seen.max(axis=0) + VIEW_MARGIN_M
    height_in = WIDTH_IN * (high - low)[1] / (high - low)[0]
    figure = Figure(figsize=(WIDTH_IN, height_in + 1.2), layout="constrained")
    axes = figure.subplots()
    draw_plan(axes, plan)
    for index, (name, part) in enumerate(parts_m.items()):
        width = NARROWEST + STEP * (len(parts_m) - 1 - index)
        joined = _joined(part)
        axes.plot(
            *joined.T, color=colour(index), linewidth=width, label=name, solid_capstyle="butt", alpha=0.9
        )
    axes.plot(*site.positions_m.T, "*", color=AP_COLOUR, markersize=10, label="access points")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(f"{title} ({MADE_UP})" if site.made_up else title)
    figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    return figure


def _joined(paths: Sequence[Floats]) -> Floats:
    """Return paths one after the other, a row of NaN between two so that no line joins them."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([row for path in paths for row in (path, gap)]) if paths else gap
