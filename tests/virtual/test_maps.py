from __future__ import annotations

import numpy as np
import pytest
import torch

import fploc.virtual.maps
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.models.deepvit import DeepViT
from fploc.models.generator import Generator
from fploc.sites.site import AccessPoint, Site
from fploc.virtual.dropout import Dropout
from fploc.virtual.maps import MAP_STEP_M, distribution_between, generator_maps
from fploc.virtual.site import VirtualSite


@pytest.fixture(scope="module")
def hall() -> VirtualSite:
    """A hall of 8 m × 5 m with a wall across from y = 2 m up, at x = 4 m."""
    walls = np.zeros((70, 100), dtype=np.bool_)
    walls[10:12, 10:90] = walls[58:60, 10:90] = walls[10:60, 10:12] = walls[10:60, 88:90] = True
    walls[10:40, 50:52] = True
    plan = FloorPlan(
        "hall", np.where(walls, 0, 255).astype(np.uint8), walls, Georeference.of_raster((-1.0, 6.0), 0.1)
    )
    points = tuple(AccessPoint(f"AP{x}", f"00:00:00:00:00:0{x}", x, 2.5, 2.0) for x in (1, 7))
    torch.manual_seed(0)
    vision = DeepViT(
        crop_height_px=8, max_length_px=24, patch_px=(8, 4), dim=8, depth=1, num_heads=2, head_dim=4
    )
    generator = Generator(vision)
    site = Site("hall", "hall", points, device_height_m=1.0)
    return VirtualSite(site, plan, generator, vision.crops, Dropout((1.0,)), 0.0)


def test_maps_hold_the_means_of_each_free_cell_and_nothing_elsewhere(hall: VirtualSite) -> None:
    maps = generator_maps(hall)
    shape = (2, maps.grid.rows, maps.grid.columns)
    assert maps.range_error_m.shape == maps.rss_dbm.shape == shape
    np.testing.assert_array_equal(np.isnan(maps.range_error_m), np.isnan(maps.rss_dbm))
    cells = np.flatnonzero(np.isfinite(maps.range_error_m[1]).ravel())
    centres = torch.tensor(maps.grid.centres_m(cells), dtype=torch.float32)
    assert float(torch.cdist(centres, hall.cells).min(dim=1).values.max()) < MAP_STEP_M
    access_point = hall.access_points[1].expand(len(cells), 2)
    with torch.no_grad():
        expected = hall.distribution(access_point, centres)
    np.testing.assert_allclose(maps.range_error_m[1].ravel()[cells], expected.mean_error(), atol=1e-4)
    np.testing.assert_allclose(maps.rss_dbm[1].ravel()[cells], expected.mean_rss(), atol=1e-3)


def test_no_map_is_drawn_inside_a_wall(hall: VirtualSite) -> None:
    maps = generator_maps(hall)
    cells = np.flatnonzero(np.isfinite(maps.rss_dbm[0]).ravel())
    column, row = np.round(hall.plan.georeference.to_pixels(maps.grid.centres_m(cells))).astype(int).T
    assert len(cells) > 100 and not hall.plan.walls[row, column].any()


def test_links_come_in_the_order_of_places_whatever_the_batches(
    hall: VirtualSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = hall.places(9, torch.Generator().manual_seed(0))
    monkeypatch.setattr(fploc.virtual.maps, "LINKS_AT_ONCE", 4)
    made = distribution_between(hall, places)
    assert made.shift.shape == (18,)
    for index in (0, 3, 8):
        with torch.no_grad():
            alone = hall.distribution(hall.access_points, places[index].expand(2, 2))
        for name in ("shift", "tail", "rss_mean"):
            ours = getattr(made, name)[2 * index : 2 * index + 2]
            torch.testing.assert_close(ours, getattr(alone, name), atol=1e-4, rtol=1e-4)
