"""Figures of results: distribution of errors, tracks on the plan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.floorplan.plan import FloorPlan
from fploc.plots.palette import AP_COLOUR, TRUTH_COLOUR, colour, line_style
from fploc.plots.plan_axes import draw_plan
from fploc.sites.site import Site

Floats = NDArray[np.float64]

LARGEST_ERROR_M = 6.0
MADE_UP = "made-up building, no real data"


def plot_cdf(errors_m: Mapping[str, Floats], title: str, *, made_up: bool = False) -> Figure:
    """Return the distribution of errors of several methods (paper, figures of CDFs).

    Args:
        errors_m: Errors of every interval, shape (N,), metres, by method.
        title: Of the figure.
        made_up: True where the data are made up: the figure says so.
    """
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for index, (name, errors) in enumerate(errors_m.items()):
        ordered = np.sort(errors[np.isfinite(errors)])
        shares = np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
        axes.plot(
            ordered, shares, label=name, color=colour(index), linestyle=line_style(index), linewidth=1.8
        )
    axes.set(
        xlim=(0, LARGEST_ERROR_M), ylim=(0, 1), xlabel="localization error [m]", ylabel="share of intervals"
    )
    axes.set_title(f"{title} ({MADE_UP})" if made_up else title)
    axes.grid(alpha=0.3)
    if errors_m:
        axes.legend(loc="lower right")
    return figure


def plot_tracks(
    plan: FloorPlan, site: Site, truth_m: Floats, tracks_m: Mapping[str, Floats], title: str
) -> Figure:
    """Return ground truth and estimated tracks of one recording on the plan.

    Args:
        plan: The plan.
        site: For the access points.
        truth_m: Ground truth, shape (T, 2), metres, site frame.
        tracks_m: Estimates by name, shape (T, 2) each, metres; NaN where there is none.
        title: Of the figure.
    """
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.subplots()
    draw_plan(axes, plan)
    for index, (name, track) in enumerate(tracks_m.items()):
        axes.plot(*track.T, ".", markersize=3, color=colour(index), label=name, alpha=0.6)
    axes.plot(*truth_m.T, color=TRUTH_COLOUR, linewidth=1.4, label="ground truth")
    axes.plot(
        *site.positions_m.T, "*", color=AP_COLOUR, markersize=9, label="access points", linestyle="none"
    )
    seen = np.concatenate([site.positions_m, truth_m[np.isfinite(truth_m).all(axis=1)]])
    low, high = seen.min(axis=0) - 4.0, seen.max(axis=0) + 4.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(f"{title} ({MADE_UP})" if site.made_up else title)
    figure.legend(loc="outside lower center", ncols=6, markerscale=1.4, fontsize="small")
    return figure
