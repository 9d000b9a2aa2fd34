from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fploc.datasets.path_parts import (
    FITTED_SHARE,
    GAP_M,
    along_path_m,
    apart,
    first_share,
    halves,
    only,
    sides,
)
from fploc.datasets.recordings import Recording
from fploc.sites.site import AccessPoint, Site

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
UNKNOWN = np.array([np.nan, np.nan])


def walked(labels_m: Floats, name: str = "1") -> Recording:
    """Return a recording along ``labels_m`` that heard one access point all the way."""
    shape = (len(labels_m), 1)
    return Recording(
        site="hall",
        device=1,
        name=name,
        t_s=0.3 * np.arange(len(labels_m)),
        slant_m=np.full(shape, 5.0),
        std_m=np.zeros(shape),
        rss_dbm=np.full(shape, -50.0),
        heard=np.ones(shape, dtype=bool),
        published_m=labels_m + 100.0,
        repaired_m=labels_m,
    )


def straight(length_m: float = 20.0, intervals: int = 81) -> Floats:
    """Return a walk along x with ever longer steps."""
    x_m = length_m * np.linspace(0.0, 1.0, intervals) ** 2
    return np.column_stack([x_m, np.zeros(intervals)])


def quarter_circle(radius_m: float = 10.0, intervals: int = 158) -> tuple[Floats, Floats]:
    """Return a walk on an arc and how far along it each interval is, by the closed form."""
    angle = np.linspace(0.0, np.pi / 2, intervals)
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)]), radius_m * angle


def with_holes(labels_m: Floats) -> Floats:
    """Return the labels without those at both ends and in a long stretch within the second quarter."""
    known = labels_m.copy()
    number = len(labels_m)
    known[:3], known[-4:] = UNKNOWN, UNKNOWN
    known[number // 4 : number // 4 + number // 8] = UNKNOWN
    return known


def nearest_m(one: Bools, other: Bools, along_m: Floats) -> float:
    return float(np.abs(along_m[one][:, None] - along_m[other]).min())


def test_a_device_is_as_far_along_as_it_has_walked() -> None:
    corner = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [3.0, 4.0], [0.0, 0.0]])
    assert along_path_m(corner).tolist() == [0.0, 3.0, 7.0, 7.0, 12.0]


def test_between_labels_a_device_moves_evenly_and_beyond_them_not_at_all() -> None:
    labels = np.array([UNKNOWN, [0.0, 0.0], UNKNOWN, UNKNOWN, [6.0, 0.0], UNKNOWN])
    assert along_path_m(labels).tolist() == [0.0, 0.0, 2.0, 4.0, 6.0, 6.0]


def test_a_straight_path_is_cut_at_half_its_length_not_at_half_its_time() -> None:
    labels = straight()
    first, second = halves(walked(labels))
    np.testing.assert_array_equal(first, labels[:, 0] < 9.5)
    np.testing.assert_array_equal(second, labels[:, 0] > 10.5)
    assert first.sum() > 1.5 * second.sum()


def test_a_curved_path_is_cut_along_its_arc() -> None:
    labels, along = quarter_circle()
    first, second = halves(walked(labels))
    middle = 2.5 * np.pi
    clear = np.abs(np.abs(along - middle) - GAP_M / 2) > 0.01
    np.testing.assert_array_equal(first[clear], (along < middle - GAP_M / 2)[clear])
    np.testing.assert_array_equal(second[clear], (along > middle + GAP_M / 2)[clear])


@pytest.mark.parametrize("labels", [straight(), quarter_circle()[0]], ids=["straight", "curved"])
@pytest.mark.parametrize("holes", [False, True])
def test_nothing_tested_is_nearer_than_the_gap_to_anything_learned(labels: Floats, holes: bool) -> None:
    recording = walked(with_holes(labels) if holes else labels)
    first, second = halves(recording)
    along = along_path_m(recording.repaired_m)
    assert first.any() and second.any() and not (first & second).any()
    assert nearest_m(first, second, along) > GAP_M
    assert first[0] and second[-1], "what has no label at the ends belongs to the part that it adjoins"
    assert nearest_m(first, second, along_path_m(labels)) > 0.9 * GAP_M, "by the true path as well"


def test_unlabelled_intervals_go_with_the_stretch_that_they_lie_in() -> None:
    labels = straight()
    np.testing.assert_array_equal(
        halves(walked(with_holes(labels)))[0][10:40], halves(walked(labels))[0][10:40]
    )


def test_a_path_that_stands_still_or_is_unknown_has_no_parts() -> None:
    for labels in (np.zeros((5, 2)), np.full((5, 2), np.nan), np.array([UNKNOWN, [1.0, 2.0]])):
        assert not np.any(halves(walked(labels)))


def test_a_path_hardly_longer_than_the_gap_leaves_its_two_ends() -> None:
    first, second = halves(walked(np.column_stack([np.linspace(0.0, 1.2, 13), np.zeros(13)])))
    assert np.flatnonzero(first).tolist() == [0] and np.flatnonzero(second).tolist() == [12]


def hall(*x_m: float) -> Site:
    access_points = tuple(
        AccessPoint(f"AP{x}", f"00:00:00:00:00:0{i}", x, 0.0, 2.0) for i, x in enumerate(x_m)
    )
    return Site(name="hall", place="hall", access_points=access_points, device_height_m=1.0)


def test_sides_are_left_and_right_of_the_middle_of_the_access_points() -> None:
    x_m = np.array([-9.0, 2.4, 2.6, 3.0, 3.4, 3.6, 40.0, np.nan])
    left, right = sides(walked(np.column_stack([x_m, np.zeros(8)])), hall(-2.0, 0.0, 8.0))
    assert np.flatnonzero(left).tolist() == [0, 1]
    assert np.flatnonzero(right).tolist() == [5, 6], "without a label it is on neither side"


def test_sides_stay_apart_however_often_the_middle_is_crossed() -> None:
    angle = np.linspace(0.0, 6 * np.pi, 600)
    recording = walked(np.column_stack([4.0 * np.cos(angle), angle]))
    left, right = sides(recording, hall(-1.0, 1.0))
    x_m = recording.repaired_m[:, 0]
    assert nearest_m(left, right, x_m) > GAP_M
    assert left.sum() == pytest.approx(right.sum(), rel=0.02)


@pytest.mark.parametrize("share", [0.25, FITTED_SHARE])
def test_the_first_share_of_a_part_ends_before_the_rest_begins(share: float) -> None:
    recording = walked(straight(40.0, 401))
    part, tested = halves(recording)
    learned, validating = first_share(part, recording, share)
    x_m = recording.repaired_m[:, 0]
    length = x_m[part].max()
    np.testing.assert_array_equal(learned, x_m < share * length - GAP_M / 2)
    np.testing.assert_array_equal(validating, part & (x_m > share * length + GAP_M / 2))
    assert learned.any() and validating.any()
    assert not (learned & validating).any() and not ((learned | validating) & tested).any()


def test_only_the_part_counts_towards_a_share() -> None:
    """Left, right, left again: the way on the right is no way of the left part."""
    x_m = np.concatenate([np.linspace(-10.0, 30.0, 401), np.linspace(30.0, -10.0, 401)])
    recording = walked(np.column_stack([x_m, np.zeros(802)]))
    left, _ = sides(recording, hall(-1.0, 1.0))
    learned, validating = first_share(left, recording, 0.5)
    assert np.flatnonzero(learned).max() < 401 < np.flatnonzero(validating).min()
    assert np.all(x_m[learned] < -0.5) and np.all(x_m[validating] < -0.5)
    assert learned.sum() == pytest.approx(validating.sum(), abs=10)


def test_an_empty_part_has_empty_shares() -> None:
    recording = walked(straight())
    assert not np.any(first_share(np.zeros(len(recording), dtype=bool), recording, 0.8))


def test_recordings_without_anything_left_are_left_out() -> None:
    one, other = walked(straight(), "1"), walked(straight(), "2")
    mask = np.arange(len(one)) >= 70
    (kept,) = only([one, other], [mask, np.zeros(len(other), dtype=bool)])
    assert kept.name == "1" and len(kept) == 11
    np.testing.assert_array_equal(kept.t_s, one.t_s[70:])
    np.testing.assert_array_equal(kept.repaired_m, one.repaired_m[70:])
    np.testing.assert_array_equal(kept.slant_m, one.slant_m[70:])


def test_nothing_is_tested_where_a_path_comes_back_to_what_any_recording_is_learned_from() -> None:
    labels = straight()
    there_and_back = np.concatenate([labels, labels[::-1]])
    once, twice = walked(labels), walked(there_and_back)
    parts = [halves(once), halves(twice)]
    (_, second), (_, returning) = apart([once, twice], parts)
    assert not returning.any(), "the way back is the way there"
    assert not second.any(), "the other recording learns there"
    (_, alone), *_ = apart([once], parts[:1])
    np.testing.assert_array_equal(alone, parts[0][1])


def test_what_has_no_label_stays_in_its_part() -> None:
    recording = walked(with_holes(straight()))
    ((_, second),) = apart([recording], [halves(recording)])
    np.testing.assert_array_equal(second, halves(recording)[1])
