"""Access points and trajectories on the plan, a panel for each stage of a method."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil

import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import AP_COLOUR, TRUTH_COLOUR, colour
from fploc.plots.plan_axes import draw_plan
from fploc.plots.results import MADE_UP
from fploc.sites.site import Site

Floats = NDArray[np.float64]

COLUMNS = 2
PANEL_IN = 5.0
VIEW_MARGIN_M = 5.0


def plot_trajectories(
    plan: FloorPlan, site: Site, truth_m: Floats, stages_m: Mapping[str, Floats], *, title: str
) -> Figure:
    """Return the ground truth and what each stage made of it, two panels a row (paper, figures of locations).

    Args:
        plan: The plan.
        site: For the access points, which are named.
        truth_m: Ground truth, shape (T, 2), metres, site frame; NaN where there is none.
        stages_m: Positions by the name of their stage, at least one, shape (T, 2) each, metres; NaN where
            there is none. Positions outside the view are counted in the panel's title.
        title: Of the figure.
    """
    seen = np.concatenate([site.positions_m, truth_m[np.isfinite(truth_m).all(axis=1)]])
    low, high = seen.min(axis=0) - VIEW_MARGIN_M, seen.max(axis=0) + VIEW_MARGIN_M
    rows, columns = ceil(len(stages_m) / COLUMNS), min(COLUMNS, len(stages_m))
    aspect = (high - low)[1] / (high - low)[0]
    figure = Figure(
        figsize=(PANEL_IN * columns + 0.5, (PANEL_IN * aspect + 0.3) * rows + 1.1), layout="constrained"
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for unused in panels[len(stages_m) :]:
        unused.remove()
    for index, (axes, (name, positions)) in enumerate(zip(panels, stages_m.items(), strict=False)):
        draw_plan(axes, plan)
        axes.plot(*positions.T, ".", markersize=2.5, color=colour(0), label="estimated")
        axes.plot(*truth_m.T, color=TRUTH_COLOUR, linewidth=1.3, label="ground truth")
        axes.plot(*site.positions_m.T, "*", color=AP_COLOUR, markersize=9, label="access points")
        if index == 0:
            for ap in site.access_points:
                axes.annotate(
                    ap.name, (ap.x_m, ap.y_m), xytext=(0, 6), textcoords="offset points", ha="center",
                    fontsize=8, fontweight="bold", color=AP_COLOUR, zorder=5, annotation_clip=True,
                    path_effects=[patheffects.withStroke(linewidth=2.5, foreground="white")],
                )  # fmt: skip
        known = positions[np.isfinite(positions).all(axis=1)]
        outside = int(((known < low) | (known > high)).any(axis=1).sum())
        axes.set_title(f"{name} ({outside} of {len(known)} outside)" if outside else name, fontsize=10)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_xlabel("x [m]" if index >= len(stages_m) - columns else "")
        axes.set_ylabel("y [m]" if index % columns == 0 else "")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=1.6, fontsize="small")
    figure.suptitle(f"{title} ({MADE_UP})" if site.made_up else title)
    return figure
