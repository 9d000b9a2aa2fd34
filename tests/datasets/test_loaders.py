from __future__ import annotations

import numpy as np
import torch

from fploc.datasets.loaders import BalancedBatches, balanced_batches
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.sites.site import AccessPoint, Site

# Three places: one of two sites (one and two devices), one of one site and device, one of one site and two devices.
PLACES = [[[40], [7, 900]], [[3]], [[10, 10]]]
SHARES = [1 / 6, 1 / 12, 1 / 12, 1 / 3, 1 / 6, 1 / 6]
SIZES = [40, 7, 900, 3, 10, 10]
DRAWS = 6000


def sampler(seed: int = 0, batches: int = DRAWS) -> BalancedBatches:
    return BalancedBatches(PLACES, batch_size=4, batches=batches, seed=seed)


def test_places_are_drawn_alike_then_their_sites_then_the_devices_there() -> None:
    drawn = np.array([number for number, _ in sampler()])
    shares = np.bincount(drawn, minlength=len(SIZES)) / DRAWS
    # Four standard deviations of the rarest share: sqrt(p (1 - p) / n).
    np.testing.assert_allclose(shares, SHARES, atol=4 * np.sqrt(0.25 / DRAWS))


def test_intervals_of_a_set_are_drawn_alike_and_none_beyond_it() -> None:
    rows = {number: [] for number in range(len(SIZES))}
    for number, drawn in sampler():
        assert len(drawn) == 4
        rows[number] += drawn
    for number, size in enumerate(SIZES):
        assert 0 <= min(rows[number]) <= max(rows[number]) < size
    counts = np.bincount(rows[3], minlength=3)
    np.testing.assert_allclose(counts / counts.sum(), 1 / 3, atol=0.03)
    assert len(set(rows[2])) > 600, "large sets are drawn from all over"


def test_one_seed_repeats_and_two_differ() -> None:
    first, again, other = (list(sampler(seed, 20)) for seed in (3, 3, 4))
    assert first == again != other


def test_epochs_go_on_with_the_stream_and_have_their_length() -> None:
    once = sampler(batches=20)
    first, second = list(once), list(once)
    assert len(once) == len(first) == len(second) == 20 and first != second
    assert first + second == list(sampler(batches=40))


def intervals(name: str, x_m: float, number: int) -> MeasuredIntervals:
    """Return intervals of a site whose positions and access point all lie at ``x_m``."""
    site = Site(name, name, (AccessPoint("AP", "00:00:00:00:00:01", x_m, 0.0, 1.0),), device_height_m=1.0)
    white = np.full((4, 4), 255, dtype=np.uint8)
    pixels_from_metres = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 3.0]])
    plan = FloorPlan(name, white, white == 0, Georeference(pixels_from_metres))
    labels = np.column_stack([np.full(number, x_m), np.arange(number)])
    ranges = np.full((number, 1), 2.0)
    recording = Recording(
        site=name,
        device=1,
        name="1",
        t_s=np.arange(number) * 0.3,
        slant_m=ranges,
        std_m=0.0 * ranges,
        rss_dbm=-50.0 + 0.0 * ranges,
        heard=ranges > 0,
        published_m=labels,
        repaired_m=labels,
    )
    return MeasuredIntervals([recording], [ranges], site, plan, "repaired")


def test_every_batch_is_of_one_set_with_its_own_plan_and_access_points() -> None:
    sets = [intervals(f"site-{x}", float(x), size) for x, size in enumerate(SIZES)]
    places = [[[sets[0]], [sets[1], sets[2]]], [[sets[3]]], [[sets[4], sets[5]]]]
    loader = balanced_batches(places, batch_size=5, batches=60, seed=1)
    batches: list[LabelledIntervals] = list(loader)
    assert len(batches) == len(loader) == 60
    seen = set()
    for batch in batches:
        (number,) = batch.positions[:, 0].unique().long().tolist()
        seen.add(number)
        assert batch.positions.shape == (5, 2) and batch.intervals.ranges.shape == (5, 1)
        assert batch.plan is sets[number].plan
        assert torch.equal(batch.access_points, sets[number].access_points)
        assert float(batch.positions[:, 1].max()) < SIZES[number]
    assert seen == set(range(len(SIZES)))
