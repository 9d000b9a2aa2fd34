from __future__ import annotations

import numpy as np
import pandas as pd

from fploc.datasets.paired import LinkReadings, PairedLap, latest_before, paired_laps
from fploc.datasets.recordings import Recording

LINKS = pd.DataFrame(
    {
        "lap": ["10", "7", "7", "7", "8"],
        "t_ms": [0.0, 0.0, 500.0, 1000.0, 0.0],
        "range_m": [9.0, 5.0, np.nan, 7.0, 1.0],
        "range_std_m": [0.1] * 5,
        "rss_dbm": [-50.0, -60.0, -61.0, np.nan, -40.0],
    }
)


def recording(device: int, name: str, t_s: list[float] | None = None) -> Recording:
    times = np.array([0.0, 1.0, 2.0] if t_s is None else t_s)
    zeros = np.zeros((len(times), 2))
    return Recording(
        site="s", device=device, name=name, t_s=times, slant_m=zeros, std_m=zeros, rss_dbm=zeros,
        heard=zeros > 0, published_m=zeros, repaired_m=zeros,
    )  # fmt: skip


def lap(t_first: list[float], t_second: list[float], t_link: list[float]) -> PairedLap:
    times = np.array(t_link)
    link = LinkReadings(times, times + 1, times - 60)
    return PairedLap("7", (recording(1, "713", t_first), recording(2, "724", t_second)), link)


def test_laps_are_paired_by_the_name_of_the_lap_whatever_the_order_of_recordings() -> None:
    both = [recording(2, "724"), recording(1, "1013"), recording(1, "713"), recording(2, "1024")]
    found = paired_laps(both, LINKS)
    assert [one.name for one in found] == ["10", "7"]
    assert [[one.name for one in pair.devices] for pair in found] == [["1013", "1024"], ["713", "724"]]


def test_a_lap_without_one_of_the_devices_or_without_a_link_is_left_out() -> None:
    recordings = [recording(1, "713"), recording(2, "724"), recording(1, "813"), recording(1, "913"),
                  recording(2, "924")]  # fmt: skip
    assert [one.name for one in paired_laps(recordings, LINKS)] == ["7"]
    assert paired_laps([], LINKS) == []


def test_readings_without_a_range_are_left_out() -> None:
    (found,) = paired_laps([recording(1, "713"), recording(2, "724")], LINKS)
    np.testing.assert_array_equal(found.link.t_s, [0.0, 1.0])
    np.testing.assert_array_equal(found.link.ranges_m, [5.0, 7.0])
    np.testing.assert_array_equal(found.link.rss_dbm, [-60.0, np.nan])


def test_the_latest_before_is_never_from_the_future_nor_too_old() -> None:
    index, is_fresh = latest_before(
        np.array([1.0, 2.0, 4.0]), np.array([0.5, 1.0, 1.9, 3.5, 3.6, 9.0]), oldest_s=1.5
    )
    np.testing.assert_array_equal(is_fresh, [False, True, True, True, False, False])
    np.testing.assert_array_equal(index[is_fresh], [0, 0, 1])
    assert not latest_before(np.array([]), np.array([1.0]), oldest_s=9.0)[1].any()


def test_a_shift_moves_the_clock_it_names_and_nothing_else() -> None:
    given = lap([0.0, 1.0], [0.5, 1.5], [0.2, 0.7])
    by_link, by_second = given.shifted(link_s=5.0), given.shifted(second_s=-5.0)
    np.testing.assert_array_equal(by_link.link.t_s, [5.2, 5.7])
    np.testing.assert_array_equal(by_link.devices[1].t_s, [0.5, 1.5])
    np.testing.assert_array_equal(by_link.devices[0].t_s, [0.0, 1.0])
    np.testing.assert_allclose(by_second.devices[1].t_s - by_second.devices[0].t_s, [-4.5, -4.5])
    np.testing.assert_allclose(by_second.link.t_s - by_second.devices[0].t_s, [0.2, -0.3])
    for moved in (by_link, by_second):
        assert all(one.t_s.min() >= 0.0 for one in moved.devices)
        np.testing.assert_array_equal(moved.link.ranges_m, given.link.ranges_m)


def test_thinning_keeps_the_clocks_together_over_gaps() -> None:
    """Device 2 pauses for 6 s: with the first time steps kept it would be 3 s early behind the pause."""
    given = lap([0.0, 1.0, 2.0, 3.0, 8.0, 9.0], [0.0, 1.0, 2.0, 8.0, 9.0], [0.0, 2.0, 8.0])
    thin = given.thinned(2)
    assert [len(one) for one in thin.devices] == [3, 3]
    np.testing.assert_array_equal(thin.devices[1].t_s, [0.0, 1.0, 4.5])
    np.testing.assert_array_equal(thin.link.t_s, [0.0, 4.0])
    np.testing.assert_array_equal(thin.link.ranges_m, [1.0, 9.0])


def test_thinning_by_one_changes_nothing() -> None:
    given = lap([0.0, 1.0], [0.5, 1.5], [0.2, 0.7])
    np.testing.assert_array_equal(given.thinned(1).devices[1].t_s, given.devices[1].t_s)
    np.testing.assert_array_equal(given.thinned(1).link.t_s, given.link.t_s)
