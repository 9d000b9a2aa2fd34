"""Recordings at a glance: distributions of what was measured, what is missing in which, and their clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.plots.palette import colour, line_style
from fploc.plots.results import MADE_UP

Floats = NDArray[np.float64]

WIDTH_IN = 8.0
ROW_IN = 0.3
LONGEST_STEP_S = 2.0
DARK_SHARE = 0.55
"""Cells above it are dark enough for white figures."""


@dataclass(frozen=True, eq=False)
class MeasuredValues:
    """What one device measured at a site, all recordings together.

    Args:
        range_m: Slant ranges, metres.
        rss_dbm: Signal strengths, dBm.
        std_m: The phone's own spread of each range, metres.
        heard: Access points with a range, of each interval.
        step_s: Time from each interval to the next, seconds.
        speed_mps: Labelled speed, metres per second.
    """

    range_m: Floats
    rss_dbm: Floats
    std_m: Floats
    heard: Floats
    step_s: Floats
    speed_mps: Floats


def plot_measured_values(
    devices: Mapping[str, MeasuredValues], title: str, *, made_up: bool = False
) -> Figure:
    """Return six histograms with a line for each device, in percent of its own values.

    Args:
        devices: By how they are called.
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    figure = Figure(figsize=(10.5, 6.0), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    most = max((int(values.heard.max(initial=0)) for values in devices.values()), default=0)
    bins = {
        "range_m": ("range, no offset removed [m]", np.arange(0.0, 62.0, 2.0)),
        "rss_dbm": ("signal strength [dBm]", np.arange(-95.0, -24.0, 2.0)),
        "std_m": ("spread told by the phone [m]", np.arange(0.0, 2.05, 0.05)),
        "heard": ("access points with a range", np.arange(-0.5, most + 1.0)),
        "step_s": ("time to the next interval [s]", np.arange(0.0, 1.525, 0.025)),
        "speed_mps": ("labelled speed, over 5 s [m/s]", np.arange(0.0, 0.61, 0.02)),
    }
    for axes, (name, (label, edges)) in zip(panels, bins.items(), strict=True):
        for index, (device, values) in enumerate(devices.items()):
            _histogram(axes, getattr(values, name), edges, index, device)
        axes.set(xlabel=label, xlim=(edges[0], edges[-1]))
        axes.grid(alpha=0.3)
    for axes in panels[::3]:
        axes.set_ylabel("share [%]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=max(len(labels), 1), fontsize="small")
    figure.suptitle(f"{title} ({MADE_UP})" if made_up else title)
    return figure


def plot_heard_shares(
    recordings: Sequence[str],
    access_points: Sequence[str],
    shares: Floats,
    title: str,
    *,
    made_up: bool = False,
) -> Figure:
    """Return how often each access point was heard with a range in each recording.

    Args:
        recordings: Their names, R.
        access_points: Their names, A.
        shares: Shape (R, A), 0 to 1.
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(recordings) + 1.4), layout="constrained")
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        shade = "white" if share > DARK_SHARE else "black"
        axes.text(column, row, f"{100 * share:.0f}", ha="center", va="center", fontsize=8, color=shade)
    axes.set_xticks(range(len(access_points)), access_points)
    axes.set_yticks(range(len(recordings)), recordings)
    axes.set_title(f"{title} ({MADE_UP})" if made_up else title)
    axes.set_xlabel("intervals in which the access point has a range [%]")
    return figure


def plot_time_steps(recordings: Mapping[str, Floats], title: str, *, made_up: bool = False) -> Figure:
    """Return the time step of every interval, a strip for each recording; longer ones are drawn at the edge.

    Args:
        recordings: Device times by the name of the recording, shape (T,) each, seconds.
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(recordings) + 1.4), layout="constrained")
    axes = figure.subplots()
    for row, t_s in enumerate(recordings.values()):
        steps = np.diff(t_s)
        axes.plot(
            np.minimum(steps, LONGEST_STEP_S), np.full(len(steps), row), "|", color=colour(0), alpha=0.25,
            markersize=9,
        )  # fmt: skip
        longest = float(steps.max(initial=0.0))
        axes.text(
            1.01, row, f"longest {longest:.1f} s", transform=axes.get_yaxis_transform(), va="center", fontsize=8,
            color=colour(1) if longest > LONGEST_STEP_S else "black",
        )  # fmt: skip
    axes.set_yticks(range(len(recordings)), list(recordings))
    axes.set(xlim=(0.0, LONGEST_STEP_S * 1.02), ylim=(len(recordings) - 0.5, -0.5))
    axes.set_xlabel("time to the next interval [s]")
    axes.set_title(f"{title} ({MADE_UP})" if made_up else title)
    axes.grid(axis="x", alpha=0.3)
    return figure


def _histogram(axes: Axes, values: Floats, edges: Floats, index: int, label: str) -> None:
    weights = np.full(len(values), 100.0 / max(len(values), 1))
    axes.hist(
        np.clip(values, edges[0], edges[-1]), edges.tolist(), weights=weights, histtype="step", linewidth=1.6,
        color=colour(index), linestyle=line_style(index), label=label,
    )  # fmt: skip
