from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.plots.attention import plot_attention

CROP = np.linspace(0, 1, 8 * 21).reshape(8, 21)


def test_each_map_lies_over_the_crop_in_metres(tmp_path: Path) -> None:
    first = np.arange(12.0).reshape(2, 6)
    figure = plot_attention(
        CROP, {"class token": first, "patches": -first}, patch_px=(4, 5), pixels_per_metre=2.0, title="a link"
    )
    above, one, two, *bars = figure.axes
    assert len(bars) == 2 and [one.get_title(), two.get_title()] == ["class token", "patches"]
    for axes in (above, one, two):
        np.testing.assert_array_equal(np.asarray(axes.images[0].get_array()), CROP)
        assert axes.images[0].get_extent() == pytest.approx([0, 10.5, -2, 2])
        assert axes.get_xlim() == pytest.approx((0, 10.5)) and axes.get_ylim() == pytest.approx((-2, 2))
    # 21 columns are 5 patches of 5 pixels, the last of them cut; the sixth patch is padding.
    shown = one.images[1]
    np.testing.assert_array_equal(np.asarray(shown.get_array()), first[:, :5])
    assert shown.get_extent() == pytest.approx([0, 12.5, -2, 2])
    assert shown.get_clim() == (0.0, 10.0) and two.images[1].get_clim() == (-10.0, 0.0)
    assert figure.get_suptitle() == "a link"
    figure.savefig(tmp_path / "attention.png")


def test_even_attention_and_made_up_buildings() -> None:
    figure = plot_attention(
        CROP, {"even": np.ones((1, 5))}, patch_px=(8, 5), pixels_per_metre=2.0, title="a link", made_up=True
    )
    low, high = figure.axes[1].images[1].get_clim()
    assert low < high
    assert "made-up" in figure.get_suptitle()
