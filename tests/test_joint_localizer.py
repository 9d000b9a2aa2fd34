from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.paired import NO_LINK, LinkReadings
from fploc.datasets.recordings import Bools, Floats, Recording
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.raster import PlanRaster
from fploc.joint_localizer import (
    Beside,
    DeviceLinkSettings,
    company,
    joint_tracks,
    link_offsets,
    ranged_tracks,
)
from fploc.localizer import Track, localize
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.methods.interface import Method
from fploc.methods.registry import geometric_method
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, DistanceHead
from fploc.models.gnn import GNN
from fploc.sites.site import AccessPoint, Site
from fploc.solvers.nonlinear import solve_nonlinear

PLACES = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (9.0, 6.0)]
NONE = RangeOffsets("none", 0.0)
FILTER = KalmanSettings()
SETTINGS = DeviceLinkSettings.read()
STEPS = 60
OFFSET_M = 2.0


def site_of(order: list[int]) -> Site:
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", *PLACES[index], 1.0) for index in order
        ),
        device_height_m=1.0,
    )


SITE = site_of([0, 1, 2, 3, 4])


def walked(device: int, t_s: Floats) -> Floats:
    """Two devices that walk towards and past each other."""
    along = 0.4 * t_s
    return np.column_stack([3 + along, 3 + 0.3 * along] if device == 1 else [17 - along, 12 - 0.2 * along])


def recording(device: int, heard: Bools | None = None) -> Recording:
    t_s = 0.5 * np.arange(STEPS) + (0.0 if device == 1 else 0.1)
    path = walked(device, t_s)
    there = np.ones((STEPS, len(PLACES)), dtype=np.bool_) if heard is None else heard
    ranges = np.linalg.norm(path[:, None] - SITE.positions_m, axis=2)
    return Recording(
        site="box",
        device=device,
        name="713" if device == 1 else "724",
        t_s=t_s,
        slant_m=np.where(there, ranges, 0.0),
        std_m=np.zeros_like(ranges),
        rss_dbm=np.where(there, -60.0, 0.0),
        heard=there,
        published_m=path,
        repaired_m=path,
    )


def link(offset_m: float = 0.0) -> LinkReadings:
    """Read when device 2 is; device 1 stood elsewhere 0.1 s before, by 5 cm."""
    t_s = recording(2).t_s
    away = walked(1, t_s - 0.1) - walked(2, t_s)
    return LinkReadings(t_s, np.linalg.norm(away, axis=1) + offset_m, np.full(STEPS, -55.0))


def two_heard(columns: tuple[int, int] = (1, 2)) -> Bools:
    """Device 2 hears two access points from the fourth second on."""
    heard = np.ones((STEPS, len(PLACES)), dtype=np.bool_)
    heard[8:] = np.isin(np.arange(len(PLACES)), columns)
    return heard


def gnn() -> GNNMethod:
    torch.manual_seed(0)
    network = GNN(8, 4, 2)
    torch.nn.init.normal_(network.update_ffnn[-1].weight, std=0.02)
    return GNNMethod(network.eval(), variance_m2=1.0)


def gnn_fpdnn() -> GNNFPDNN:
    torch.manual_seed(0)
    vision = DeepViT(20, 200, (20, 10), dim=8, depth=1, num_heads=2, head_dim=4)
    return GNNFPDNN(
        coarse=gnn(),
        network=FPDNN(vision, DistanceHead(64)).eval(),
        plan=PlanRaster(torch.rand(200, 400), torch.tensor([[10.0, 0.0, 20.0], [0.0, -10.0, 180.0]])),
        crops=vision.crops,
        solver=solve_nonlinear,
        sigma_m=1.0,
        filter_settings=FILTER,
    )


def true_ranges(method: GNNFPDNN, monkeypatch: pytest.MonkeyPatch) -> GNNFPDNN:
    """Let FPDNN give back the ranges that it is given: here they are the distances."""
    monkeypatch.setattr(
        method, "corrected_ranges", lambda intervals, access_points, coarse: intervals.ranges.double()
    )
    return method


def alone(method: Method, *recordings: Recording, site: Site = SITE) -> list[Track]:
    return localize(method, site, recordings, NONE, FILTER)


def exact(track: Track) -> Track:
    """Return a track that knows where it is to the millimetre."""
    path = replace(
        track.unfiltered,
        positions_m=track.recording.repaired_m,
        covariances_m2=np.tile(1e-6 * np.eye(2), (STEPS, 1, 1)),
        reasons=np.zeros(STEPS, dtype=np.int64),
    )
    return replace(track, unfiltered=path, filtered=path)


def error_m(path: Floats, track: Track) -> Floats:
    errors: Floats = np.linalg.norm(path - track.recording.repaired_m, axis=1)
    return errors


CERTAIN = replace(SETTINGS, offset=replace(SETTINGS.offset, prior_sd_m=1e-3, nearest_m=1e3))
"""The link's offset is known, and nothing more is learned of it."""
METHODS = pytest.mark.parametrize(
    "made", [lambda: geometric_method("nls"), lambda: geometric_method("trilateration"), gnn, gnn_fpdnn],
    ids=["nls", "trilateration", "gnn", "gnn-fpdnn"],
)  # fmt: skip


@pytest.mark.parametrize(
    "name", ["lls", "nls", "nls-weighted", "nls-robust", "nls-onesided", "trilateration"]
)
def test_noise_free_ranges_and_link_give_both_devices_to_a_micrometre(name: str) -> None:
    method = geometric_method(name)
    first, second = (exact(track) for track in alone(method, recording(1), recording(2)))
    pairs = [Beside(first, second, link()), Beside(second, first, link())]
    for track in joint_tracks(method, SITE, pairs, NONE, FILTER, CERTAIN):
        assert track.unfiltered.fixed.all()
        assert error_m(track.unfiltered.positions_m, track).max() < 1e-6


@pytest.mark.parametrize(
    "name", ["lls", "nls", "nls-weighted", "nls-robust", "nls-onesided", "trilateration"]
)
def test_two_access_points_and_the_link_fix_device_2_and_without_it_nothing_does(name: str) -> None:
    method = geometric_method(name)
    first, second = alone(method, recording(1), recording(2, two_heard()))
    assert not second.unfiltered.fixed[8:].any()
    (track,) = joint_tracks(method, SITE, [Beside(second, exact(first), link())], NONE, FILTER, CERTAIN)
    assert track.unfiltered.fixed.all()
    assert np.median(error_m(track.unfiltered.positions_m, track)) < 1e-6


def test_behind_fpdnn_two_access_points_and_the_link_fix_it_on_the_side_of_the_coarse_position(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    method = true_ranges(gnn_fpdnn(), monkeypatch)
    first, second = alone(method, recording(1), recording(2, two_heard()))
    (track,) = joint_tracks(method, SITE, [Beside(second, exact(first), link())], NONE, FILTER, CERTAIN)
    assert track.unfiltered.fixed.all() and not second.unfiltered.fixed[8:].any()
    assert np.median(error_m(track.unfiltered.positions_m, track)) < 1e-6


@METHODS
def test_without_a_link_it_is_the_way_of_one_device(made: Callable[[], Method]) -> None:
    method = made()
    heard = two_heard()
    heard[40:] = True
    tracks = alone(method, recording(1), recording(2, heard))
    pairs = [Beside(tracks[0], tracks[1], NO_LINK), Beside(tracks[1], tracks[0], NO_LINK)]
    for before, after in zip(tracks, joint_tracks(method, SITE, pairs, NONE, FILTER, SETTINGS), strict=True):
        assert before.filtered is not None and after.filtered is not None
        for one, other in ((before.unfiltered, after.unfiltered), (before.filtered, after.filtered)):
            np.testing.assert_array_equal(one.reasons, other.reasons)
            np.testing.assert_allclose(one.positions_m, other.positions_m, atol=1e-5)
            np.testing.assert_allclose(one.covariances_m2, other.covariances_m2, atol=1e-5)


@METHODS
def test_the_order_of_devices_and_of_access_points_does_not_matter(made: Callable[[], Method]) -> None:
    method = made()
    given = [recording(1), recording(2, two_heard())]
    first, second = alone(method, *given)
    pairs = [Beside(first, second, link(OFFSET_M)), Beside(second, first, link(OFFSET_M))]
    expected = joint_tracks(method, SITE, pairs, NONE, FILTER, SETTINGS)
    swapped = joint_tracks(method, SITE, pairs[::-1], NONE, FILTER, SETTINGS)[::-1]
    order = [3, 0, 4, 2, 1]
    mixed = [
        replace(
            one, **{name: getattr(one, name)[:, order] for name in ("slant_m", "std_m", "rss_dbm", "heard")}
        )
        for one in given
    ]
    first, second = alone(method, *mixed, site=site_of(order))
    pairs = [Beside(first, second, link(OFFSET_M)), Beside(second, first, link(OFFSET_M))]
    reordered = joint_tracks(method, site_of(order), pairs, NONE, FILTER, SETTINGS)
    for one, *others in zip(expected, swapped, reordered, strict=True):
        for other in others:
            np.testing.assert_allclose(one.unfiltered.positions_m, other.unfiltered.positions_m, atol=2e-3)


def test_the_gnn_counts_the_other_device_among_three_neighbours() -> None:
    method = gnn()
    first, second = alone(method, recording(1), recording(2, two_heard()))
    pair = Beside(second, first, link())
    (track,) = joint_tracks(method, SITE, [pair], NONE, FILTER, SETTINGS)
    assert track.unfiltered.fixed.all() and not second.unfiltered.fixed[8:].any()
    assert not np.allclose(track.unfiltered.positions_m[:8], second.unfiltered.positions_m[:8])


def test_device_1_leads_where_a_method_is_chained() -> None:
    method = geometric_method("nls")
    first, second = alone(method, recording(1), recording(2))
    wrong = link(3.0)
    tracks = joint_tracks(
        method, SITE, [Beside(first, second, wrong), Beside(second, first, wrong)], NONE, FILTER, CERTAIN
    )
    np.testing.assert_allclose(tracks[0].unfiltered.positions_m, first.unfiltered.positions_m)
    assert error_m(tracks[1].unfiltered.positions_m, tracks[1]).max() > 0.1


def test_the_offset_is_learned_from_the_tracks_alone_and_uses_no_label() -> None:
    method = geometric_method("nls")
    state = replace(SETTINGS.offset, prior_sd_m=5.0, correlation_s=0.5, nearest_m=3.0)
    long = replace(SETTINGS, offset=state)
    first, second = alone(method, recording(1), recording(2))
    pair = Beside(first, second, link(OFFSET_M))
    learned = link_offsets(pair, prior_m=0.0, settings=long)
    assert learned.means_m[0] == pytest.approx(0.0, abs=1e-9)
    assert learned.means_m[-1] == pytest.approx(OFFSET_M, abs=0.5)
    nan = np.full((STEPS, 2), np.nan)
    blind = [
        replace(track, recording=replace(track.recording, published_m=nan, repaired_m=nan))
        for track in (first, second)
    ]
    unlabelled = link_offsets(Beside(blind[0], blind[1], pair.link), prior_m=0.0, settings=long)
    np.testing.assert_array_equal(learned.means_m, unlabelled.means_m)
    beside = company(pair, prior_m=0.0, settings=long)
    late = beside.is_linked & (first.t_s > 20)
    distances = np.linalg.norm(walked(1, first.t_s) - walked(2, first.t_s), axis=1)
    np.testing.assert_allclose(beside.ranges_m[late], distances[late], atol=0.6)


def test_two_access_points_teach_nothing_of_the_offset() -> None:
    heard = np.tile(np.isin(np.arange(len(PLACES)), (1, 2)), (STEPS, 1))
    first, second = alone(geometric_method("nls"), recording(1), recording(2, heard))
    learned = link_offsets(Beside(second, first, link(OFFSET_M)), prior_m=1.0, settings=SETTINGS)
    np.testing.assert_allclose(learned.means_m, 1.0, atol=1e-9)


def test_nothing_stands_beside_a_device_from_the_future_or_too_old() -> None:
    first, second = alone(geometric_method("nls"), recording(1), recording(2))
    late = replace(link(), t_s=link().t_s + 10.0)
    beside = company(Beside(first, second, late), prior_m=0.0, settings=SETTINGS)
    ends = late.t_s[-1] + SETTINGS.oldest_s
    np.testing.assert_array_equal(
        beside.is_linked, (first.t_s >= late.t_s[0]) & (first.t_s <= min(ends, second.t_s[-1] + 1.5))
    )
    assert (second.t_s[beside.other[beside.is_linked]] <= first.t_s[beside.is_linked]).all()
    np.testing.assert_array_equal(beside.is_placed, beside.is_linked)


def test_what_comes_later_changes_no_earlier_fix() -> None:
    method = gnn()
    half = STEPS // 2
    spoilt = recording(1)
    spoilt = replace(spoilt, slant_m=np.where(np.arange(STEPS)[:, None] < half, spoilt.slant_m, 40.0))
    found = []
    for leader in (recording(1), spoilt):
        first, second = alone(method, leader, recording(2, two_heard()))
        pairs = [Beside(second, first, link(OFFSET_M))]
        found.append(joint_tracks(method, SITE, pairs, NONE, FILTER, SETTINGS)[0].unfiltered.positions_m)
    np.testing.assert_array_equal(found[0][: half - 1], found[1][: half - 1])
    assert not np.allclose(found[0][half + 1 :], found[1][half + 1 :])


def test_ranges_in_the_filter_carry_device_2_on_where_two_are_heard() -> None:
    method = geometric_method("nls")
    first, second = alone(method, recording(1), recording(2, two_heard((0, 4))))
    by_ranges, by_link = (
        ranged_tracks(SITE, [Beside(second, first, log)], NONE, FILTER, SETTINGS)[0]
        for log in (NO_LINK, link())
    )
    assert by_ranges.filtered is not None and by_link.filtered is not None and second.filtered is not None
    assert by_ranges.filtered.fixed.all() and by_link.filtered.fixed.all()
    held = np.linalg.norm(second.filtered.positions_m[7] - second.recording.repaired_m[-1])
    errors = [error_m(path.positions_m, second)[-1] for path in (by_ranges.filtered, by_link.filtered)]
    assert errors[1] < errors[0] < held / 2
    np.testing.assert_array_equal(by_link.unfiltered.positions_m, second.unfiltered.positions_m)


def test_a_device_that_never_has_a_fix_starts_no_track_by_ranges() -> None:
    heard = np.tile(np.isin(np.arange(len(PLACES)), (1, 2)), (STEPS, 1))
    first, second = alone(geometric_method("nls"), recording(1), recording(2, heard))
    (track,) = ranged_tracks(SITE, [Beside(second, first, link())], NONE, FILTER, SETTINGS)
    assert track.filtered is not None and not track.filtered.fixed.any()
