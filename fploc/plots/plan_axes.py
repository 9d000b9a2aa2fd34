"""A plan under everything else, in metres."""

from __future__ import annotations

from matplotlib.axes import Axes

from fploc.floorplan.plan import FloorPlan

PALE = 0.55


def draw_plan(axes: Axes, plan: FloorPlan, *, opacity: float = PALE) -> None:
    """Draw ``plan`` into ``axes``, x right and y up, metres of the site frame."""
    height, width = plan.grey.shape
    (left, top), (right, bottom) = plan.georeference.to_metres([[-0.5, -0.5], [width - 0.5, height - 0.5]])
    axes.imshow(
        plan.grey,
        cmap="gray",
        extent=(float(left), float(right), float(bottom), float(top)),
        alpha=opacity,
        vmin=0,
        vmax=255,
    )
