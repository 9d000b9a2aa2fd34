"""Bars of RMSE, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fploc.plots.palette import colour, hatch
from fploc.plots.results import MADE_UP

GROUP_WIDTH = 0.8


@dataclass(frozen=True)
class RmseRow:
    """RMSE of one method at one place, from one training.

    Args:
        place: Site and device, as it is to stand below the bars.
        method: Name of the method.
        rmse_m: Metres; None where there was nothing to score.
        paper_m: What the paper says of this method there, metres; empty where it says nothing.
    """

    place: str
    method: str
    rmse_m: float | None
    paper_m: tuple[float, ...] = ()


def plot_rmse_bars(rows: Sequence[RmseRow], title: str, *, made_up: bool = False) -> Figure:
    """Return a group of bars for each place, a bar for each method, a diamond for each of the paper's values.

    Rows of one place and method are different seeds: their bar is the mean, with one standard deviation to
    both sides.

    Args:
        rows: In the order in which places and methods are to stand.
        title: Of the figure.
        made_up: True where the data are made up: the figure says so.
    """
    places = list(dict.fromkeys(row.place for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    width = GROUP_WIDTH / max(len(methods), 1)
    figure = Figure(figsize=(max(6.4, 2.0 * len(places)), 4.6), layout="constrained")
    axes = figure.subplots()
    paper: list[tuple[float, float]] = []
    for index, method in enumerate(methods):
        of_method = [row for row in rows if row.method == method]
        seeds = [
            [row.rmse_m for row in of_method if row.place == place and row.rmse_m is not None]
            for place in places
        ]
        centres = np.arange(len(places)) + (index - (len(methods) - 1) / 2) * width
        axes.bar(
            centres,
            [float(np.mean(values)) if values else np.nan for values in seeds],
            width=0.9 * width,
            yerr=[float(np.std(values, ddof=1)) if len(values) > 1 else np.nan for values in seeds],
            color=colour(index),
            hatch=hatch(index),
            edgecolor="white",
            ecolor="black",
            label=method,
        )
        paper += dict.fromkeys(
            (float(centres[places.index(row.place)]), value) for row in of_method for value in row.paper_m
        )
    if paper:
        axes.plot(
            *zip(*paper, strict=True),
            "D",
            color="white",
            markeredgecolor="black",
            markersize=6,
            label="paper",
        )
    axes.set_xticks(range(len(places)), places)
    axes.set(ylabel="RMSE [m]", title=f"{title} ({MADE_UP})" if made_up else title)
    axes.set_ylim(bottom=0)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
    if rows:
        figure.legend(loc="outside lower center", ncols=6, fontsize="small")
    return figure
