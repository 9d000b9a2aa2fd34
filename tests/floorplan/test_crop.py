from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from fploc.floorplan.crop import Crops, crop_links, crop_softened_links, ink_of, soften
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan

GEOREFERENCE = Georeference.of_raster((0.0, 20.0), 0.05)
MATRIX = torch.tensor(GEOREFERENCE.pixels_from_metres.copy())


def drawing() -> Tensor:
    """A plan of 20 m × 20 m at 20 px/m: one wall from x = 10 to 10.2 m, on y from 0 to 12 m."""
    ink = torch.zeros(400, 400)
    ink[160:, 200:204] = 1.0
    return ink


def crop(ink: Tensor, starts: list | Tensor, ends: list | Tensor, **changed: float) -> Crops:
    arguments = {"pixels_per_metre": 20.0, "width_m": 4.0, "length_px": 320} | changed
    return crop_links(
        ink, MATRIX, torch.as_tensor(starts, dtype=torch.float32), torch.as_tensor(ends, dtype=torch.float32),
        **arguments,  # type: ignore[arg-type]
    )  # fmt: skip


def test_wall_appears_at_its_distance() -> None:
    crops = crop(drawing(), [[4.0, 5.0]], [[14.0, 5.0]])
    assert crops.images.shape == (1, 1, 80, 320)
    assert crops.lengths_px.tolist() == [200]
    # 6.0 m to 6.2 m from the start at 20 px/m.
    columns = crops.images[0, 0].mean(dim=0)
    np.testing.assert_allclose(columns[120:124], 1.0, atol=1e-4)
    assert columns[:119].max() == columns[125:].max() == 0.0


def test_start_is_left_and_left_hand_is_above() -> None:
    # Northwards beside the wall, which lies from 1.0 to 1.2 m to the right: below the middle row.
    crops = crop(drawing(), [[9.0, 2.0]], [[9.0, 10.0]])
    rows = crops.images[0, 0, :, 10:150].mean(dim=1)
    np.testing.assert_allclose(rows[60:64], 1.0, atol=1e-4)
    assert rows[:59].max() == 0.0
    # Southwards it is to the left; the wall ends at y = 12, so it begins 1 m along.
    crops = crop(drawing(), [[9.0, 13.0]], [[9.0, 5.0]])
    assert crops.images[0, 0, 16:20, 21:150].min() > 0.99
    assert crops.images[0, 0, :, :19].max() == 0.0


@settings(max_examples=40, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(1.0, 6.0), st.sampled_from([8.0, 20.0, 32.0]))
def test_turning_the_scene_changes_nothing(angle: float, length: float, pixels_per_metre: float) -> None:
    """The same drawing through a turned georeference gives the same crop."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    straight = GEOREFERENCE.pixels_from_metres
    turned = torch.tensor(np.column_stack([straight[:, :2] @ turn.T, straight[:, 2]]))
    ends = np.array([[9.0, 6.0], [9.0 + length, 7.0]])
    arguments = {"pixels_per_metre": pixels_per_metre, "length_px": 200}
    plain = crop_links(drawing(), MATRIX, *torch.tensor(ends).split(1), **arguments)
    moved = crop_links(drawing(), turned, *torch.tensor(ends @ turn.T).split(1), **arguments)
    assert abs(int(plain.lengths_px[0] - moved.lengths_px[0])) <= 1
    shared = int(min(plain.lengths_px[0], moved.lengths_px[0]))
    torch.testing.assert_close(plain.images[..., :shared], moved.images[..., :shared], atol=5e-3, rtol=0)


def test_turned_walls_look_alike() -> None:
    """A wall drawn at 45° and crossed at a right angle gives the same ink as a straight one."""
    v, u = torch.meshgrid(torch.arange(400.0), torch.arange(400.0), indexing="ij")
    across = ((u - 200) - (v - 200)) / np.sqrt(2)
    ink = (0.5 - (across.abs() - 2.0)).clamp(0, 1)
    # Lower left of the image's middle is along (-1, -1) in pixels: towards −x and +y in metres.
    centre = np.array(GEOREFERENCE.to_metres([200, 200]))
    step = 3.0 * np.array([1.0, 1.0]) / np.sqrt(2)
    crops = crop(ink, [(centre - step).tolist()], [(centre + step).tolist()])
    profile = crops.images[0, 0, 20:60].mean(dim=0)
    assert float(profile.sum()) / 20.0 == pytest.approx(0.2, abs=0.01)
    assert int(profile.argmax()) == pytest.approx(60, abs=2)


def test_batch_is_one_by_one() -> None:
    generator = torch.Generator().manual_seed(0)
    ink = torch.rand(400, 400, generator=generator)
    starts, ends = torch.rand(2, 50, 2, generator=generator) * 24 - 2
    together = crop(ink, starts, ends, pixels_per_metre=8.0, length_px=160)
    for index in range(50):
        alone = crop(
            ink, starts[index : index + 1], ends[index : index + 1], pixels_per_metre=8.0, length_px=160
        )
        torch.testing.assert_close(alone.images[0], together.images[index], atol=1e-4, rtol=0)
        assert alone.lengths_px[0] == together.lengths_px[index]


def test_padding_is_zero_and_masked_never_stretched() -> None:
    ink = torch.ones(400, 400)
    crops = crop(ink, [[10, 10], [10, 10], [10, 10]], [[12, 10], [10, 10], [10, 30]], length_px=100)
    # 2 m; no length at all, which keeps one column; 20 m, cut to what fits.
    assert crops.lengths_px.tolist() == [40, 1, 100]
    assert crops.mask.sum(dim=1).tolist() == [40, 1, 100]
    assert (crops.images[0, 0, :, 40:] == 0).all()
    assert (crops.images[0, 0, :, :40] == 1).all()
    assert torch.isfinite(crops.images).all()


def test_outside_the_plan_is_free() -> None:
    crops = crop(torch.ones(400, 400), [[-10.0, 10.0]], [[5.0, 10.0]])
    profile = crops.images[0, 0].mean(dim=0)
    assert profile[:199].max() == 0.0
    assert profile[201:300].min() == 1.0


@pytest.mark.parametrize("pixels_per_metre", [2.0, 4.0, 8.0, 13.0, 20.0, 64.0])
@pytest.mark.parametrize("wall_at", [200, 201, 203, 206])
def test_thin_walls_survive_coarse_crops(pixels_per_metre: float, wall_at: int) -> None:
    """A line of one pixel keeps its ink at every resolution and place: 0.05 m of black."""
    ink = torch.zeros(400, 400)
    ink[:, wall_at] = 1.0
    crops = crop(ink, [[4.0, 10.0]], [[16.0, 10.0]], pixels_per_metre=pixels_per_metre, length_px=800)
    profile = crops.images[0, 0].mean(dim=0)
    # Bilinear reading between coarse samples spreads a line but does not lose it.
    assert float(profile.sum()) / pixels_per_metre == pytest.approx(0.05, rel=0.15)
    assert profile.max() > 0.3 * min(1.0, pixels_per_metre / 20.0)


def test_softening_keeps_ink() -> None:
    ink = torch.zeros(60, 60)
    ink[20:30, 40:43] = 1.0
    for pixels in (1.0, 1.5, 2.0, 2.5, 3.0, 7.3):
        assert float(soften(ink, pixels).sum()) == pytest.approx(30.0, rel=1e-5)
    assert soften(ink, 0.3) is ink
    assert float(soften(torch.ones(60, 60), 2.5)[30, 30]) == pytest.approx(1.0)


def test_ink_is_darkness() -> None:
    grey = np.array([[255, 0], [204, 128]], dtype=np.uint8)
    ink = ink_of(FloorPlan("drawn", grey, grey < 200, GEOREFERENCE))
    torch.testing.assert_close(ink, torch.tensor([[0.0, 1.0], [0.2, 127 / 255]]))


def test_mixed_precision_moves_nothing() -> None:
    plain = crop(drawing(), [[4.0, 5.0]], [[14.0, 7.0]])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = crop(drawing(), [[4.0, 5.0]], [[14.0, 7.0]])
    torch.testing.assert_close(plain.images, mixed.images)


def test_no_links() -> None:
    crops = crop(drawing(), torch.empty(0, 2), torch.empty(0, 2))
    assert crops.images.shape == (0, 1, 80, 320)
    assert crops.mask.shape == (0, 320)


def test_a_crop_is_4_m_wide_where_nothing_else_is_asked_for() -> None:
    ends = torch.tensor([[4.0, 5.0]]), torch.tensor([[14.0, 5.0]])
    crops = crop_links(drawing(), MATRIX, *ends, pixels_per_metre=20.0, length_px=320)
    torch.testing.assert_close(crops.images, crop(drawing(), *ends).images)
    same = crop_softened_links(drawing(), MATRIX, *ends, pixels_per_metre=20.0, length_px=320)
    torch.testing.assert_close(same.images, crops.images)


def test_crops_have_the_type_of_the_drawing() -> None:
    double = crop(drawing().double(), [[4.0, 5.0]], [[14.0, 5.0]])
    assert double.images.dtype == torch.float64
    single = crop(drawing(), [[4.0, 5.0]], [[14.0, 5.0]])
    torch.testing.assert_close(double.images.float(), single.images, atol=1e-4, rtol=0)


def test_ink_runs_from_0_where_free_to_1_where_black() -> None:
    grey = np.array([[0, 51, 255]], np.uint8)
    ink = ink_of(FloorPlan("grey", grey, grey < 200, GEOREFERENCE))
    torch.testing.assert_close(ink, torch.tensor([[1.0, 0.8, 0.0]]))


def test_a_link_without_length_looks_along_x() -> None:
    # The wall ends 4 cm to the right: one column, as of a link of one pixel that way.
    (at,) = crop(drawing(), [[10.16, 5.0]], [[10.16, 5.0]]).images
    (right,) = crop(drawing(), [[10.16, 5.0]], [[10.21, 5.0]]).images
    torch.testing.assert_close(at, right)
    assert at[..., 0].min() > 0.5 and at[..., 1:].max() == 0.0
