"""Accuracy against the number of access points."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fploc.plots.palette import colour, line_style
from fploc.plots.results import MADE_UP


def plot_access_points(
    rmse_m: Mapping[str, Mapping[int, float]], title: str, *, made_up: bool = False
) -> Figure:
    """Return a line for each method over the number of access points.

    Args:
        rmse_m: RMSE by method and number of access points, metres; at least one method.
        title: Of the figure.
        made_up: True where the data are made up: the figure says so.
    """
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes = figure.subplots()
    for index, (method, by_count) in enumerate(rmse_m.items()):
        counts = sorted(by_count)
        axes.plot(
            counts,
            [by_count[count] for count in counts],
            label=method,
            color=colour(index),
            linestyle=line_style(index),
            marker="o",
            markersize=4,
        )
    axes.set(
        xlabel="access points",
        ylabel="RMSE in metres",
        title=f"{title} ({MADE_UP})" if made_up else title,
    )
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=3.5)
    return figure
