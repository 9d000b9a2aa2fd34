from __future__ import annotations

import numpy as np
import pytest
import torch

from fploc.floorplan.crop import crop_links
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import CropSettings, PlanRaster

SETTINGS = CropSettings(pixels_per_metre=5.0, width_m=4.0, max_length_px=60, patch_length_px=10)


@pytest.fixture
def plan() -> FloorPlan:
    """20 m × 10 m at 10 px/m with one wall from x = 8 m to 8.4 m."""
    grey = np.full((100, 200), 255, dtype=np.uint8)
    grey[:, 80:84] = 0
    return FloorPlan("drawn", grey, grey < 128, Georeference.of_raster((0.0, 10.0), 0.1))


def test_raster_is_the_plan_as_ink_with_its_georeference(plan: FloorPlan) -> None:
    raster = PlanRaster.of(plan)
    assert raster.ink.dtype == raster.pixels_from_metres.dtype == torch.float32
    assert raster.ink.shape == (100, 200)
    assert raster.ink[:, 80:84].min() == 1.0 and raster.ink.sum() == 400
    point = torch.tensor([8.25, 4.05, 1.0])
    column, row = (raster.pixels_from_metres @ point).tolist()
    assert (column, row) == (pytest.approx(82.0, abs=1e-4), pytest.approx(59.0, abs=1e-4))


def test_raster_moves_whole_and_once(plan: FloorPlan) -> None:
    raster = PlanRaster.of(plan)
    moved = raster.to("meta")
    assert moved.ink.is_meta and moved.pixels_from_metres.is_meta
    assert raster.to("meta") is moved and raster.to("cpu") is raster


def test_crops_are_padded_to_whole_patches_of_the_longest_link(plan: FloorPlan) -> None:
    starts = torch.tensor([[2.0, 5.0], [2.0, 5.0]])
    # 6 m are 30 columns.
    for length_m, width in ((5.7, 30), (6.5, 40)):
        ends = torch.tensor([[2.0 + length_m, 5.0], [3.0, 5.0]])
        crops = SETTINGS.crop(PlanRaster.of(plan), starts, ends)
        assert crops.images.shape == (2, 1, 20, width)
        assert crops.lengths_px.tolist() == [round(length_m * 5), 5]
        assert crops.images[1, ..., 5:].max() == 0.0


@pytest.mark.parametrize("length_m", [0.0, 0.1, 1.9, 2.0, 2.05, 3.99, 4.0, 4.11, 11.9, 12.0])
def test_every_length_fits_its_crop(plan: FloorPlan, length_m: float) -> None:
    start = torch.tensor([[1.0, 5.0]])
    crops = SETTINGS.crop(PlanRaster.of(plan), start, start + torch.tensor([[length_m, 0.0]]))
    width = crops.images.shape[-1]
    assert width % 10 == 0 and 10 <= width <= 60
    assert int(crops.lengths_px) == max(1, round(length_m * 5)) <= width


def test_links_beyond_the_longest_crop_lose_their_end(plan: FloorPlan) -> None:
    start = torch.tensor([[2.0, 5.0]])
    crops = SETTINGS.crop(PlanRaster.of(plan), start, torch.tensor([[19.0, 5.0]]))
    assert crops.images.shape[-1] == 60 and crops.lengths_px.tolist() == [60]
    # The wall begins 6 m = 30 columns from the start and is 2 columns thick.
    ink = crops.images[0, 0].mean(0)
    torch.testing.assert_close(ink.sum(), torch.tensor(2.0), rtol=0.0, atol=1e-3)
    assert ink[:29].max() == ink[33:].max() == 0.0


def test_crop_is_the_same_as_asked_for_by_hand(plan: FloorPlan) -> None:
    raster = PlanRaster.of(plan)
    starts, ends = torch.tensor([[2.0, 3.0]]), torch.tensor([[9.0, 8.0]])
    ours = SETTINGS.crop(raster, starts, ends)
    theirs = crop_links(
        raster.ink,
        raster.pixels_from_metres,
        starts,
        ends,
        pixels_per_metre=5.0,
        width_m=4.0,
        length_px=ours.images.shape[-1],
    )
    assert torch.equal(ours.images, theirs.images)


def test_no_links_give_no_crops(plan: FloorPlan) -> None:
    crops = SETTINGS.crop(PlanRaster.of(plan), torch.zeros(0, 2), torch.zeros(0, 2))
    assert crops.images.shape == (0, 1, 20, 10) and crops.lengths_px.shape == (0,)
