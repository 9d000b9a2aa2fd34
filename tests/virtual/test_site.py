from __future__ import annotations

import numpy as np
import pytest
import torch

from fploc.datasets.samples import LabelledIntervals
from fploc.errors import FplocError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import free_space, line_of_sight
from fploc.models.deepvit import DeepViT
from fploc.models.generator import Generator
from fploc.sites.site import AccessPoint, Site
from fploc.virtual.dropout import Dropout
from fploc.virtual.site import CLEARANCE_M, VirtualIntervals, VirtualSite

SCALE = 10
"""Pixels per metre of the drawing."""

AP_POSITIONS = ((1.0, 1.0), (15.0, 1.0), (1.0, 9.0), (15.0, 9.0), (6.0, 5.0))


def plan(has_wall: bool = True) -> FloorPlan:
    """A hall of 16 m × 10 m with walls all round, and one at x = 8 m with a door from y = 4 to 5.5 m.

    The drawing shows 1 m of outside on every side; a closed cell of 1 m² lies in a corner.
    """
    walls = np.zeros((120, 180), dtype=np.bool_)
    walls[10:12, 10:170] = walls[108:110, 10:170] = True
    walls[10:110, 10:12] = walls[10:110, 168:170] = True
    if has_wall:
        walls[10:55, 90:92] = walls[70:110, 90:92] = True
    walls[12:24, 148:150] = walls[22:24, 148:170] = True
    grey = np.where(walls, 0, 255).astype(np.uint8)
    return FloorPlan("hall", grey, walls, Georeference.of_raster((-1.0, 11.0), 1 / SCALE))


def site() -> Site:
    points = tuple(
        AccessPoint(f"AP{i}", f"00:00:00:00:00:0{i}", x, y, 2.0) for i, (x, y) in enumerate(AP_POSITIONS)
    )
    return Site("hall", "hall", points, device_height_m=1.0)


@pytest.fixture(scope="module")
def generator() -> Generator:
    torch.manual_seed(0)
    vision = DeepViT(
        crop_height_px=20, max_length_px=100, patch_px=(20, 10), dim=8, depth=1, num_heads=2, head_dim=4
    )
    return Generator(vision)


def virtual(
    generator: Generator,
    drawn: FloorPlan | None = None,
    shares: tuple[float, ...] = (0.9, 0.6),
    random_layout_share: float = 0.0,
) -> VirtualSite:
    return VirtualSite(
        site(),
        plan() if drawn is None else drawn,
        generator,
        generator.vision.crops,
        Dropout(shares),
        random_layout_share,
    )


def drawn(site: VirtualSite, pairs: int = 40, seed: int = 0) -> LabelledIntervals:
    return site.draw(pairs, torch.Generator().manual_seed(seed))


def clearance_m(positions: np.ndarray, walls: np.ndarray, georeference: Georeference) -> np.ndarray:
    """Distance of each position to the nearest face of a wall's pixels, by looking at all of them."""
    rows, columns = np.nonzero(walls)
    pixels = georeference.to_pixels(positions)
    offsets = np.abs(pixels[:, None] - np.stack([columns, rows], axis=-1)) - 0.5
    return np.linalg.norm(np.maximum(offsets, 0.0), axis=-1).min(axis=1) / georeference.pixels_per_metre


def test_positions_are_in_reachable_free_space_away_from_walls(generator: Generator) -> None:
    floor = plan()
    positions = drawn(virtual(generator, floor), pairs=150).positions.double().numpy()
    assert clearance_m(positions, floor.walls, floor.georeference).min() >= CLEARANCE_M - 1e-3
    # Indoors, in both rooms, not in the closed cell.
    assert positions[:, 0].min() > 0 and positions[:, 0].max() < 16
    assert (positions[:, 0] < 7.5).any() and (positions[:, 0] > 8.5).any()
    assert not ((positions[:, 0] > 14.0) & (positions[:, 1] > 8.8)).any()
    column, row = np.round(floor.georeference.to_pixels(positions)).astype(int).T
    assert free_space(floor, site().positions_m, clearance_m=CLEARANCE_M)[row, column].all()


def test_pairs_are_linked_where_they_see_each_other(generator: Generator) -> None:
    floor = plan()
    batch = drawn(virtual(generator, floor))
    links = batch.intervals.links
    assert links is not None
    receiver, sender = links.index
    assert torch.equal(receiver ^ 1, sender)
    positions = batch.positions.numpy()
    seen = line_of_sight(floor, positions[0::2], positions[1::2])
    assert 0 < seen.sum() < len(seen)
    linked = np.zeros(len(seen), dtype=np.int64)
    np.add.at(linked, receiver.numpy() // 2, 1)
    assert (linked == 2 * seen).all()
    # Both ways with one measurement.
    half = len(receiver) // 2
    assert torch.equal(links.index[:, :half], links.index[:, half:].flip(0))
    assert torch.equal(links.ranges[:half], links.ranges[half:])
    assert torch.equal(links.rss[:half], links.rss[half:])
    assert links.ranges.min() >= 0


def test_in_one_room_every_pair_is_linked(generator: Generator) -> None:
    links = drawn(virtual(generator, plan(has_wall=False)), pairs=20).intervals.links
    assert links is not None and links.index.shape[1] > 30


def test_pairs_that_do_not_see_each_other_have_no_link(generator: Generator) -> None:
    made = virtual(generator)
    positions = torch.tensor([[2.0, 2.0], [14.0, 2.0], [3.0, 8.5], [12.0, 8.0]])
    links = made.device_links(positions, torch.Generator().manual_seed(0))
    assert links.index.shape == (2, 0) and links.ranges.shape == links.rss.shape == (0,)


def test_shapes_and_values_of_a_draw(generator: Generator) -> None:
    batch = drawn(virtual(generator))
    intervals = batch.intervals
    assert batch.positions.shape == (80, 2) and batch.access_points.shape == (5, 2)
    for values in (intervals.ranges, intervals.rss, intervals.stds, intervals.heard):
        assert values.shape == (80, 5)
    assert intervals.t_s.shape == (80,) and intervals.t_s.dtype == torch.float64
    assert intervals.present.all()
    assert intervals.ranges.min() >= 0 and torch.isfinite(intervals.rss).all()
    assert (intervals.ranges[~intervals.heard] == 0).all() and (intervals.rss[~intervals.heard] == 0).all()
    assert (intervals.rss[intervals.heard] < 0).float().mean() > 0.99


def test_links_are_heard_as_often_as_at_the_source(generator: Generator) -> None:
    batch = drawn(virtual(generator, shares=(1.0, 0.3)), pairs=400)
    distances = (batch.positions[:, None] - batch.access_points).norm(dim=-1)
    assert batch.intervals.heard[distances < 5].all()
    assert float(batch.intervals.heard[distances >= 5].float().mean()) == pytest.approx(0.3, abs=0.03)


def test_ranges_are_the_distance_and_the_generators_error(generator: Generator) -> None:
    made = virtual(generator, shares=(1.0,))
    starts = torch.tensor([[1.0, 1.0]]).expand(4000, 2)
    ends = torch.tensor([[6.0, 5.0]]).expand(4000, 2)
    crops = made.crops.crop(made.raster, starts[:1], ends[:1])
    distance = (ends[:1] - starts[:1]).norm(dim=-1)
    with torch.no_grad():
        expected = generator.eval()(crops.images, crops.lengths_px, distance)
        ranges, rss = made.measure(starts, ends, torch.Generator().manual_seed(0))
    assert float(ranges.mean()) == pytest.approx(float(distance + expected.mean_error()), abs=0.1)
    assert float(rss.mean()) == pytest.approx(float(expected.mean_rss()), abs=0.7)


@pytest.mark.parametrize(("share", "kinds"), [(0.0, {True}), (1.0, {False}), (0.5, {True, False})])
def test_access_points_stand_elsewhere_in_a_share_of_the_draws(
    generator: Generator, share: float, kinds: set[bool]
) -> None:
    made = virtual(generator, random_layout_share=share)
    random = torch.Generator().manual_seed(0)
    own = torch.tensor(AP_POSITIONS)
    layouts = [made.layout(random) for _ in range(20)]
    assert {torch.equal(layout, own) for layout in layouts} == kinds
    assert all(layout.shape == own.shape for layout in layouts)


def test_one_seed_gives_the_same_stream_of_differing_epochs(generator: Generator) -> None:
    def stream(seed: int) -> list[torch.Tensor]:
        intervals = VirtualIntervals(virtual(generator, random_layout_share=0.5), 3, 2, seed=seed)
        assert len(intervals) == 2
        return [batch.intervals.ranges for _ in range(2) for batch in intervals]

    torch.manual_seed(0)
    first = stream(7)
    torch.manual_seed(1)
    again = stream(7)
    assert len(first) == 4
    assert all(torch.equal(one, two) for one, two in zip(first, again, strict=True))
    assert not any(torch.equal(first[0], later) for later in first[1:])
    assert not torch.equal(stream(8)[0], first[0])


def test_drawing_uses_no_dropout_and_no_gradient(generator: Generator) -> None:
    generator.train()
    batch = drawn(virtual(generator))
    assert not generator.training and not batch.intervals.ranges.requires_grad


def test_a_plan_without_free_space_at_the_access_points_is_refused(generator: Generator) -> None:
    solid = plan()
    full = FloorPlan("hall", solid.grey, np.ones_like(solid.walls), solid.georeference)
    with pytest.raises(FplocError, match="free space of the plan hall"):
        virtual(generator, full)
