"""Reliability of stated covariances: how many truths the regions hold, against how many they say they hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.plots.palette import colour, line_style
from fploc.plots.results import MADE_UP

Floats = NDArray[np.float64]

STATED = np.linspace(0.01, 0.99, 99)


def held_shares(nees: Floats) -> Floats:
    """Return the share of truths within the ellipses that state each share of ``STATED``, shape (99,).

    Args:
        nees: eᵀP⁻¹e of every fix in the plane, shape (N,); NaN where there is none. The ellipse that states p
            holds what is at most −2 ln(1 − p).
    """
    bounds = -2 * np.log1p(-STATED)
    known = np.sort(nees[np.isfinite(nees)])
    shares: Floats = np.searchsorted(known, bounds, side="right") / max(len(known), 1)
    return shares


def plot_reliability(nees: Mapping[str, Floats], title: str, *, made_up: bool = False) -> Figure:
    """Return held against stated shares: honest covariances lie on the diagonal, too small ones below it.

    Args:
        nees: As ``held_shares`` takes it, by place.
        title: Of the figure.
        made_up: True where the data are made up: the figure says so.
    """
    figure = Figure(figsize=(8.0, 4.8), layout="compressed")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1.0)
    for index, (name, values) in enumerate(nees.items()):
        axes.plot(STATED, held_shares(values), label=name, color=colour(index), linestyle=line_style(index))
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="stated share", ylabel="share of truths held", aspect="equal")
    axes.set_title(f"{title} ({MADE_UP})" if made_up else title)
    axes.grid(alpha=0.3)
    if nees:
        # Beside the curves: many of them leave no corner free.
        figure.legend(loc="outside right upper")
    return figure
