from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fploc.errors import FplocError
from fploc.floorplan.augmentation import CropAugmentation, Distortions
from fploc.floorplan.crop import Crops
from fploc.floorplan.raster import CropSettings, PlanRaster

CPU = torch.device("cpu")
LINKS = 60
SETTINGS = CropSettings(pixels_per_metre=10.0, width_m=4.0, max_length_px=200, patch_length_px=10)
PLAN = PlanRaster(
    ink=torch.rand(400, 400, generator=torch.Generator().manual_seed(0)),
    pixels_from_metres=torch.tensor([[10.0, 0.0, 100.0], [0.0, -10.0, 300.0]]),
)
"""From x, y = −10 m to 30 m."""


def ends() -> tuple[Tensor, Tensor]:
    places = 16 * torch.rand(2, LINKS, 2, generator=torch.Generator().manual_seed(1))
    return places[0], places[1]


def cropped(distortions: Distortions | None, plan: PlanRaster = PLAN) -> Crops:
    return SETTINGS.crop(plan, *ends(), distortions)


def plain() -> Distortions:
    return CropAugmentation.none().draw(LINKS, CPU)


def draw(augmentation: CropAugmentation, links: int = 4000) -> Distortions:
    torch.manual_seed(0)
    return augmentation.draw(links, CPU)


def test_none_changes_nothing() -> None:
    untouched, distorted = cropped(None), cropped(plain())
    assert torch.equal(untouched.images, distorted.images)
    assert torch.equal(untouched.lengths_px, distorted.lengths_px)


def test_mirroring_flips_rows() -> None:
    mirrored = cropped(replace(plain(), mirror=-torch.ones(LINKS)))
    torch.testing.assert_close(mirrored.images, cropped(None).images.flip(2))


def test_a_shift_along_brings_up_what_lies_beyond() -> None:
    """By 0.7 m, which are 7 columns."""
    shifted = cropped(replace(plain(), along=torch.full((LINKS,), 0.7)))
    untouched = cropped(None)
    both = untouched.mask[:, None, None, 7:]
    torch.testing.assert_close(
        shifted.images[..., :-7] * both, untouched.images[..., 7:] * both, atol=1e-3, rtol=0.0
    )
    assert torch.equal(shifted.lengths_px, untouched.lengths_px)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_shift_across_moves_the_drawing_down(mirror: float) -> None:
    """The window goes 0.4 m towards the upper side of the crop: 4 rows."""
    turned = replace(plain(), mirror=torch.full((LINKS,), mirror))
    shifted = cropped(replace(turned, across=torch.full((LINKS,), 0.4)))
    torch.testing.assert_close(
        shifted.images[:, :, 4:], cropped(turned).images[:, :, :-4], atol=1e-3, rtol=0.0
    )


def test_a_scale_moves_walls_away_from_the_access_point_and_keeps_the_length() -> None:
    """A wall across all links 4 m from the access point and one beside them, at 1.1 times the size."""
    ink = torch.zeros(400, 400)
    ink[:, 140:142] = 1.0
    ink[290:292, :] = 1.0
    plan = replace(PLAN, ink=ink)
    starts, far = torch.zeros(1, 2), torch.tensor([[9.0, 0.0]])
    one = CropAugmentation.none().draw(1, CPU)
    before = SETTINGS.crop(plan, starts, far, one)
    after = SETTINGS.crop(plan, starts, far, replace(one, scale=torch.tensor([1.1])))
    assert torch.equal(before.lengths_px, after.lengths_px)
    column = [int(crops.images[0, 0, 30].argmax()) for crops in (before, after)]
    # The wall's middle is at 4.05 m on the plan, half a pixel of 0.1 m before its place in the crop.
    assert column == [40, 44]
    row = [int(crops.images[0, 0, :, 20].argmax()) for crops in (before, after)]
    assert row[0] == pytest.approx(19.5 - 9, abs=1) and row[1] == pytest.approx(19.5 - 9.9, abs=1)


def test_line_weight_scales_ink_up_to_black() -> None:
    factors = torch.linspace(0.5, 1.5, LINKS)
    weighed = cropped(replace(plain(), line_weight=factors))
    expected = (cropped(None).images * factors[:, None, None, None]).clamp(max=1.0)
    torch.testing.assert_close(weighed.images, expected)


def test_strengths_bound_what_is_drawn_and_fill_their_bounds() -> None:
    drawn = draw(CropAugmentation(mirror=0.3, along_m=0.5, across_m=0.2, scale=0.1, line_weight=0.4))
    assert set(drawn.mirror.tolist()) == {1.0, -1.0}
    assert float((drawn.mirror < 0).float().mean()) == pytest.approx(0.3, abs=0.03)
    for values, middle, reach in (
        (drawn.along, 0.0, 0.5),
        (drawn.across, 0.0, 0.2),
        (drawn.scale, 1.0, 0.1),
        (drawn.line_weight, 1.0, 0.4),
    ):
        assert float(values.min()) == pytest.approx(middle - reach, abs=0.01 * reach + 1e-6)
        assert float(values.max()) == pytest.approx(middle + reach, abs=0.01 * reach + 1e-6)
        assert float(values.mean()) == pytest.approx(middle, abs=0.05 * reach)


def test_links_draw_independently_and_a_seed_repeats_them() -> None:
    one, again = draw(CropAugmentation()), draw(CropAugmentation())
    assert torch.equal(one.along, again.along) and torch.equal(one.mirror, again.mirror)
    parts = torch.stack([one.mirror, one.along, one.across, one.scale, one.line_weight])
    assert (torch.corrcoef(parts) - torch.eye(5)).abs().max() < 0.06
    assert len(one.along.unique()) > 3900


@pytest.mark.parametrize(
    "strengths",
    [{"mirror": 1.5}, {"along_m": -0.1}, {"across_m": -1.0}, {"scale": 1.0}, {"line_weight": 1.2}],
)
def test_strengths_out_of_bounds_are_refused(strengths: dict[str, float]) -> None:
    (name,) = strengths
    with pytest.raises(FplocError, match=f"{name} of the augmentation of crops"):
        CropAugmentation(**strengths)
