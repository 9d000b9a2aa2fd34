"""What walls do to RTT: range errors by the number of walls, and one link along a lap."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.plots.palette import AP_COLOUR, TRUTH_COLOUR, colour, line_style
from fploc.plots.results import MADE_UP

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_WALLS = 3
"""From here on walls are counted as 'or more'."""
SHOWN_M = (-3.0, 9.0)
BIN_M = 0.2


def walls_text(walls: int) -> str:
    """Return how links through so many walls are called; from ``MOST_WALLS`` on they are one kind."""
    more = " or more" if walls == MOST_WALLS else ""
    return f"{walls}{more} wall{'' if walls == 1 else 's'}"


def plot_errors_by_walls(error_m: Floats, walls: Ints, title: str, *, made_up: bool = False) -> Figure:
    """Return how range errors are distributed for no wall, one, two, and three or more; a tick is a median.

    Args:
        error_m: Range minus distance, shape (N,), metres.
        walls: Walls between, shape (N,).
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    bins = np.arange(SHOWN_M[0], SHOWN_M[1] + BIN_M, BIN_M)
    grouped = np.minimum(walls, MOST_WALLS)
    for number in range(MOST_WALLS + 1):
        errors = error_m[grouped == number]
        if not errors.size:
            continue
        median = float(np.median(errors))
        label = f"{walls_text(number)}: median {median:+.2f} m, {len(errors):,} readings"
        weights = np.full(len(errors), 100.0 / len(errors))
        axes.hist(
            errors, bins.tolist(), weights=weights, histtype="step", linewidth=1.8, color=colour(number),
            linestyle=line_style(number), label=label,
        )  # fmt: skip
        axes.plot(median, 0.0, "^", color=colour(number), markersize=9, clip_on=False, zorder=5)
    axes.axvline(0.0, color=TRUTH_COLOUR, linewidth=0.8)
    axes.set(
        xlim=SHOWN_M,
        xlabel="measured range − labelled distance [m]",
        ylabel=f"share of readings per {BIN_M:g} m [%]",
        title=f"{title} ({MADE_UP})" if made_up else title,
    )
    axes.grid(alpha=0.3)
    if error_m.size:
        axes.legend(loc="upper right", fontsize="small")
    return figure


def plot_link_over_time(
    t_s: Floats,
    range_m: Floats,
    distance_m: Floats,
    rss_dbm: Floats,
    walls: Ints,
    title: str,
    *,
    made_up: bool = False,
) -> Figure:
    """Return range, signal strength and walls of one link along a lap, one above the other.

    Args:
        t_s: Time, shape (N,), seconds.
        range_m: Measured range, shape (N,), metres.
        distance_m: Labelled distance, shape (N,), metres.
        rss_dbm: Signal strength, shape (N,), dBm; 0 where unknown.
        walls: Walls between, shape (N,).
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    above, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 1])
    above.plot(t_s, range_m, ".", color=colour(0), markersize=3, label="RTT range, no offset removed")
    above.plot(t_s, distance_m, color=TRUTH_COLOUR, linewidth=1.4, label="labelled distance")
    above.set(ylabel="[m]", title=f"{title} ({MADE_UP})" if made_up else title)
    above.legend(loc="upper right", fontsize="small")
    middle.plot(t_s, np.where(rss_dbm < 0.0, rss_dbm, np.nan), ".", color=colour(2), markersize=3)
    middle.set(ylabel="RSS [dBm]")
    below.fill_between(t_s, walls, step="mid", color=AP_COLOUR, alpha=0.5, linewidth=0)
    below.set(ylabel="walls", xlabel="time [s]", ylim=(0.0, max(1.0, float(walls.max(initial=0))) + 0.3))
    for axes in (above, middle, below):
        axes.grid(alpha=0.3)
    return figure
