from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from fploc.errors import FplocError
from fploc.intervals import Intervals, NoFix
from fploc.methods.fingerprints import Knn, KnnSettings
from fploc.methods.interface import Examples
from fploc.sites.site import AccessPoint, Site

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SETTINGS = replace(KnnSettings.read(), neighbours=2, range_sd_m=1.0, rss_sd_db=5.0)


def site(first: int = 0) -> Site:
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{first + index}", x, y, 2.0)
            for index, (x, y) in enumerate(CORNERS)
        ),
        device_height_m=1.0,
    )


def intervals(ranges: torch.Tensor) -> Intervals:
    heard = ranges > 0
    return Intervals(
        t_s=torch.zeros(ranges.shape[:-1], dtype=torch.float64),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=torch.where(heard, -40 - ranges, 0.0),
        heard=heard,
        present=torch.ones(ranges.shape[:-1], dtype=torch.bool),
    )


def line_of_places(shift_m: float) -> torch.Tensor:
    """Return places one metre apart for two recordings, shape (10, 2, 2); the second walk lies beside."""
    x = torch.arange(10, dtype=torch.float64) + 4.0
    walks = [torch.stack([x, torch.full_like(x, y)], -1) for y in (6.0, 6.0 + shift_m)]
    return torch.stack(walks, 1)


def examples(shift_m: float) -> Examples:
    places = line_of_places(shift_m)
    ranges = (places[:, :, None, :] - torch.tensor(CORNERS, dtype=torch.float64)).norm(dim=-1)
    return Examples(site(), None, intervals(ranges), places, torch.ones(places.shape[1], dtype=torch.int64))


def test_the_nearer_fingerprint_weighs_more() -> None:
    method = Knn(SETTINGS).fitted([examples(shift_m=4.0)])
    between = torch.tensor([[6.3, 6.0]], dtype=torch.float64)
    ranges = torch.cdist(between, torch.tensor(CORNERS, dtype=torch.float64))
    _, found = method.step(method.init(site(), 1), intervals(ranges))
    assert 6.0 < found.positions[0, 0] < 6.5
    torch.testing.assert_close(found.positions[0, 1], torch.tensor(6.0).double())


def test_its_variance_is_that_of_a_walk_it_has_not_learned() -> None:
    method = Knn(replace(SETTINGS, neighbours=1)).fitted([examples(shift_m=0.6)])
    _, found = method.step(method.init(site(), 2), intervals(examples(0.6).intervals.ranges[3]))
    expected = 0.6**2 / 2 * torch.eye(2, dtype=torch.float64)
    torch.testing.assert_close(found.covariances, expected.expand(2, 2, 2))


def test_silence_is_part_of_a_fingerprint() -> None:
    learned = examples(shift_m=0.5)
    ranges = learned.intervals.ranges.clone()
    ranges[5:, :, 1] = 0.0
    method = Knn(SETTINGS).fitted([replace(learned, intervals=intervals(ranges))])
    query = ranges[4, :1].clone()
    query[0, 1] = 0.0
    _, found = method.step(method.init(site(), 1), intervals(query))
    assert found.positions[0, 0] > 8.5
    _, nothing = method.step(method.init(site(), 1), intervals(torch.zeros_like(query)))
    assert nothing.reasons.tolist() == [NoFix.NO_READING]


def test_one_recording_cannot_say_how_good_it_is() -> None:
    learned = examples(shift_m=0.5)
    unlabelled = learned.labels.clone()
    unlabelled[:, 1] = torch.nan
    with pytest.raises(FplocError, match="1 labelled recordings of 1 sites"):
        Knn(SETTINGS).fitted([replace(learned, labels=unlabelled)])
    with pytest.raises(FplocError, match="of 2 sites"):
        Knn(SETTINGS).fitted([learned, learned])


def test_fingerprints_of_one_site_are_none_of_another() -> None:
    method = Knn(SETTINGS).fitted([examples(shift_m=0.5)])
    with pytest.raises(FplocError, match="choose the protocol `seen`"):
        method.init(site(first=5), 1)
