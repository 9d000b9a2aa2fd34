"""Where a network looks on a crop of the plan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from fploc.plots.results import MADE_UP

Floats = NDArray[np.float64]

WIDTH_IN = 8.0
NARROWEST_IN = 5.0
LARGEST_PANEL_IN = 2.2
OPACITY = 0.65
SMALLEST_RANGE = 1e-6


def plot_attention(
    crop: Floats,
    attention: Mapping[str, Floats],
    *,
    patch_px: tuple[int, int],
    pixels_per_metre: float,
    title: str,
    made_up: bool = False,
) -> Figure:
    """Return a crop as it is, and under each of several maps of attention over its patches.

    Every panel has its own scale from its least to its greatest value: the norm of re-attention moves and
    stretches whole maps, so that only differences within one say anything.

    Args:
        crop: The crop without padding, shape (H, W), 1 where a line is drawn; the access point is left.
        attention: Maps by name, shape (rows, columns) each; columns beyond the crop are left out.
        patch_px: Height and length of a patch, pixels.
        pixels_per_metre: Resolution of the crop.
        title: Of the figure.
        made_up: True where the building is made up: the figure says so.
    """
    height_m, length_m = (side / pixels_per_metre for side in crop.shape)
    panel_in = min(LARGEST_PANEL_IN, max(0.9, WIDTH_IN * 0.8 * height_m / length_m))
    width_in = min(WIDTH_IN, max(NARROWEST_IN, panel_in * length_m / height_m / 0.8))
    figure = Figure(
        figsize=(width_in, (panel_in + 0.5) * (1 + len(attention)) + 0.7),
        layout=ConstrainedLayoutEngine(w_pad=0.12),
    )
    panels = figure.subplots(1 + len(attention), 1, sharex=True, squeeze=False)[:, 0]
    for axes in panels:
        axes.imshow(
            crop,
            cmap="gray_r",
            vmin=0,
            vmax=1,
            extent=(0.0, length_m, -height_m / 2, height_m / 2),
            interpolation="none",
        )
        axes.set_ylabel("across [m]")
    panels[0].set_title("crop: access point left, device right", fontsize=10)
    patch_height_m, patch_length_m = (side / pixels_per_metre for side in patch_px)
    for axes, (name, weights) in zip(panels[1:], attention.items(), strict=True):
        columns = int(np.ceil(crop.shape[1] / patch_px[1]))
        shown = weights[:, :columns]
        least = float(shown.min())
        rows = weights.shape[0]
        image = axes.imshow(
            shown,
            cmap="viridis",
            vmin=least,
            vmax=max(float(shown.max()), least + SMALLEST_RANGE),
            alpha=OPACITY,
            extent=(
                0.0, columns * patch_length_m, height_m / 2 - rows * patch_height_m, height_m / 2,
            ),
            interpolation="none",
        )  # fmt: skip
        axes.set_title(name, fontsize=10)
        figure.colorbar(image, ax=axes, label="attention", fraction=0.04, pad=0.02)
    for axes in panels:
        axes.set(xlim=(0.0, length_m), ylim=(-height_m / 2, height_m / 2), aspect="equal", anchor="W")
    panels[-1].set_xlabel("along the link [m]")
    figure.suptitle(f"{title} ({MADE_UP})" if made_up else title)
    return figure
