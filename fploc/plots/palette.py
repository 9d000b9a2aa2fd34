"""Colours and lines of figures: safe for colour-blind readers, and told apart without colour beyond seven."""

from __future__ import annotations

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
"""Okabe and Ito 2008, without black, which is the ground truth's, and yellow, which is hard to see on white."""

AP_COLOUR = "crimson"
TRUTH_COLOUR = "black"

_LINES = ("solid", (0, (5, 2)), (0, (1, 1.5)))
_HATCHES = ("", "///", "...")


def colour(index: int) -> str:
    """Return the colour of the ``index``-th thing of a figure."""
    return COLOURS[index % len(COLOURS)]


def line_style(index: int) -> str | tuple[int, tuple[float, ...]]:
    """Return how the ``index``-th line is drawn: dashed and dotted where colours come again."""
    return _LINES[index // len(COLOURS) % len(_LINES)]


def hatch(index: int) -> str:
    """Return how the ``index``-th bar is filled where colours come again."""
    return _HATCHES[index // len(COLOURS) % len(_HATCHES)]
