from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torch import Tensor

from fploc.datasets.loaders import ordered_batches, random_batches
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.intervals import DeviceLinks
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import AccessPoint, Site

SITE = Site(
    name="hall",
    place="hall",
    access_points=(
        AccessPoint("AP1", "00:00:00:00:00:01", 0.0, 0.0, 2.0),
        AccessPoint("AP2", "00:00:00:00:00:02", 9.0, 0.0, 2.0),
        AccessPoint("AP3", "00:00:00:00:00:03", 0.0, 7.0, 2.0),
    ),
    device_height_m=1.0,
)
PLAN = FloorPlan(
    "hall",
    np.full((80, 100), 255, np.uint8),
    np.zeros((80, 100), np.bool_),
    Georeference.of_raster((0, 8), 0.1),
)


def recording(name: str, first: int) -> Recording:
    """Six intervals; of these index 1 has no label, 3 no range and 4 only one beyond 60 m."""
    slant = first + np.arange(18.0).reshape(6, 3) / 10 + 1.0
    slant[0, 2] = slant[3] = 0.0
    slant[2, 0] = FARTHEST_RANGE_M + 0.1
    slant[4] = [70.0, 0.0, 0.0]
    repaired = first + np.arange(12.0).reshape(6, 2)
    repaired[1] = np.nan
    published = repaired + 100.0
    published[5] = np.nan
    return Recording(
        site="hall",
        device=1,
        name=name,
        t_s=first + np.arange(6.0),
        slant_m=slant,
        std_m=np.full((6, 3), 0.25),
        rss_dbm=np.where(slant > 0, -50.0 - slant, 0.0),
        heard=slant > 0,
        published_m=published,
        repaired_m=repaired,
    )


RECORDINGS = [recording("113", 0), recording("213", 20)]


def measured(labels: str = "repaired") -> MeasuredIntervals:
    calibrated = [one.slant_m - 0.5 for one in RECORDINGS]
    return MeasuredIntervals(RECORDINGS, calibrated, SITE, PLAN, labels)


def test_intervals_without_label_or_range_are_left_out() -> None:
    intervals = measured()
    assert len(intervals) == 6
    assert intervals.t_s.tolist() == [0.0, 2.0, 5.0, 20.0, 22.0, 25.0]
    assert measured("published").t_s.tolist() == [0.0, 2.0, 20.0, 22.0]


def test_labels_are_of_the_kind_asked_for() -> None:
    assert measured().positions[1].tolist() == [4.0, 5.0]
    assert measured("published").positions[1].tolist() == [104.0, 105.0]


def test_what_was_not_heard_or_is_too_far_is_masked_and_zero() -> None:
    batch = measured()[[0, 1]]
    assert batch.intervals.heard.tolist() == [[True, True, False], [False, True, True]]
    np.testing.assert_allclose(batch.intervals.ranges, [[0.5, 0.6, 0.0], [0.0, 1.2, 1.3]], rtol=1e-6)
    np.testing.assert_allclose(batch.intervals.rss, [[-51.0, -51.1, 0.0], [0.0, -51.7, -51.8]], rtol=1e-6)
    assert batch.intervals.stds.tolist() == [[0.25, 0.25, 0.0], [0.0, 0.25, 0.25]]
    assert batch.intervals.present.tolist() == [True, True]
    assert batch.intervals.links is None


def test_making_intervals_leaves_the_recordings_as_they_are() -> None:
    measured()
    assert RECORDINGS[0].heard[2, 0] and RECORDINGS[0].heard[4, 0]


def test_links_of_a_batch_are_what_was_heard() -> None:
    links = measured()[[0, 1]].links
    assert links.device.tolist() == [0, 0, 1, 1]
    assert links.access_points.tolist() == [[0.0, 0.0], [9.0, 0.0], [9.0, 0.0], [0.0, 7.0]]


def tensors_of(thing: object) -> list[Tensor]:
    """Every tensor in a structure of dataclasses."""
    if isinstance(thing, Tensor):
        return [thing]
    if not dataclasses.is_dataclass(thing):
        return []
    return [
        tensor for field in dataclasses.fields(thing) for tensor in tensors_of(getattr(thing, field.name))
    ]


@pytest.mark.parametrize("links", [None, DeviceLinks(torch.tensor([[0], [1]]), torch.ones(1), torch.ones(1))])
def test_a_batch_moves_to_a_device_whole(links: DeviceLinks | None) -> None:
    batch = measured()[[0, 1]]
    batch = dataclasses.replace(batch, intervals=dataclasses.replace(batch.intervals, links=links))
    moved = batch.to("meta")
    assert isinstance(moved, LabelledIntervals)
    assert len(tensors_of(moved)) == len(tensors_of(batch)) == (10 if links is None else 13)
    assert all(tensor.is_meta for tensor in tensors_of(moved))


def test_random_batches_repeat_with_their_seed_and_differ_between_epochs() -> None:
    def epochs(seed: int) -> list[list[float]]:
        loader = random_batches(measured(), batch_size=4, batches=5, seed=seed)
        assert len(loader) == 5
        return [[time for batch in loader for time in batch.intervals.t_s.tolist()] for _ in range(2)]

    first, second = epochs(3)
    assert len(first) == 20 and first != second
    assert epochs(3) == [first, second]
    assert epochs(4)[0] != first


def test_random_batches_may_be_larger_than_the_data() -> None:
    (batch,) = random_batches(measured(), batch_size=16, batches=1, seed=0)
    assert len(batch.positions) == 16


def test_ordered_batches_hold_every_interval_once_in_order() -> None:
    batches = list(ordered_batches(measured(), batch_size=4))
    assert [len(batch.positions) for batch in batches] == [4, 2]
    times = torch.cat([batch.intervals.t_s for batch in batches])
    assert torch.equal(times, measured().t_s)
