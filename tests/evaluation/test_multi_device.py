from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Bools, Recording
from fploc.errors import FplocError
from fploc.evaluation import multi_device
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.multi_device import (
    ALL_INTERVALS,
    ALL_WITHOUT_LINK,
    LINK_IN_FILTER,
    RANGES_IN_FILTER,
    SHIFTS,
    TWO_BEST,
    TWO_MEAN,
    TWO_WORST,
    WITHOUT_LINK,
    hearing_only,
    multi_device_records,
    multi_device_tracks,
    summaries,
)
from fploc.evaluation.records import Record
from fploc.methods.interface import Method
from fploc.methods.registry import geometric_method
from fploc.sites.site import AccessPoint, Site

STEPS, LINKED_STEPS = 40, 25
PLACES = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SITE = Site(
    name="shopping-mall",
    place="mall",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 1.0)
        for index, (x, y) in enumerate(PLACES)
    ),
    device_height_m=1.0,
)
REQUEST = EvaluationRequest("multi-device", "shopping-mall", labels="repaired")


@dataclass(frozen=True)
class Made:
    """A method that can run, as the composition root makes it."""

    method: Method
    offsets: RangeOffsets
    artifact: str | None = None


def made(name: str) -> Made:
    return Made(geometric_method(name), RangeOffsets("none", 0.0))


def recording(lap: int, device: int, heard: Bools | None = None) -> Recording:
    t_s = 0.5 * np.arange(STEPS) + 0.1 * (device - 1)
    start, step = ((3.0, 3.0), (0.2, 0.1)) if device == 1 else ((17.0, 12.0), (-0.2, -0.05 * lap))
    path = np.array(start) + t_s[:, None] * np.array(step)
    ranges = np.linalg.norm(path[:, None] - SITE.positions_m, axis=2)
    there = np.ones(ranges.shape, dtype=np.bool_) if heard is None else heard
    return Recording(
        site=SITE.name, device=device, name=f"{lap}{'13' if device == 1 else '24'}", t_s=t_s,
        slant_m=np.where(there, ranges, 0.0), std_m=0 * ranges, rss_dbm=np.where(there, -60.0, 0.0),
        heard=there, published_m=path, repaired_m=path,
    )  # fmt: skip


def two_late() -> Bools:
    heard = np.ones((STEPS, len(PLACES)), dtype=np.bool_)
    heard[10:, 2:] = False
    return heard


def links(laps: tuple[int, ...] = (1, 2)) -> pd.DataFrame:
    rows = []
    for lap in laps:
        first, second = recording(lap, 1), recording(lap, 2)
        ranges = np.linalg.norm(first.repaired_m - second.repaired_m, axis=1)[:LINKED_STEPS]
        rows.append(
            pd.DataFrame(
                {
                    "lap": str(lap),
                    "t_ms": 500.0 * np.arange(LINKED_STEPS) + 100,
                    "range_m": ranges,
                    "range_std_m": 0.1,
                    "rss_dbm": -55.0,
                }
            )
        )
    return pd.concat(rows, ignore_index=True)


def packed_mall() -> SimpleNamespace:
    """Two laps of exact ranges; device 2 hears two access points from the sixth second on."""
    recordings = [
        recording(lap, device, two_late() if device == 2 else None) for lap in (1, 2) for device in (1, 2)
    ]
    return SimpleNamespace(site=SITE, device_links=links(), recordings=lambda: recordings)


@pytest.fixture(autouse=True)
def mall(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    packed = packed_mall()
    monkeypatch.setattr(multi_device, "read_packed", lambda data_root, site: packed)
    return packed


@cache
def run(name: str = "nls", request: EvaluationRequest = REQUEST) -> list[Record]:
    return multi_device_records(name, made(name), request, Path())


def test_every_condition_is_there_once_for_each_device_label_and_filter() -> None:
    records = run()
    keys = [(one.condition, one.device, one.labels, one.filter) for one in records]
    assert len(set(keys)) == len(keys)
    paired = ["", WITHOUT_LINK, ALL_INTERVALS, ALL_WITHOUT_LINK, *SHIFTS]
    expected = {(condition, device, "repaired", name) for condition in paired for device in (1, 2)
                for name in ("none", "kalman")}  # fmt: skip
    expected |= {
        (one, 2, "repaired", name) for one in (TWO_MEAN, TWO_BEST, TWO_WORST) for name in ("none", "kalman")
    }
    expected |= {
        (one, device, "repaired", "kalman") for one in (RANGES_IN_FILTER, LINK_IN_FILTER) for device in (1, 2)
    }
    assert set(keys) == expected
    assert {one.protocol for one in records} == {"multi-device"}


def test_with_and_without_the_link_are_over_the_same_intervals() -> None:
    counts = {
        (one.condition, one.device): one.n + one.n_before_first_fix for one in run() if one.filter == "none"
    }
    assert counts["", 1] == counts[WITHOUT_LINK, 1] == counts["link clock +5 s", 1]
    assert counts["", 2] == counts[WITHOUT_LINK, 2] == counts[TWO_BEST, 2]
    assert counts[ALL_INTERVALS, 2] == counts[ALL_WITHOUT_LINK, 2] == 2 * STEPS
    # Readings last for 25 intervals of half a second, and each counts for 1.5 s more: device 1 sees the first late.
    assert counts["", 2] == 2 * (LINKED_STEPS + 3)
    assert counts["", 1] == 2 * (LINKED_STEPS + 2)


def test_the_link_fixes_device_2_where_two_ranges_do_not() -> None:
    records = {(one.condition, one.device, one.filter): one for one in run()}
    alone, linked = records[WITHOUT_LINK, 2, "none"], records["", 2, "none"]
    assert alone.no_fix_share == pytest.approx(1 - 10 / (LINKED_STEPS + 3))
    assert linked.no_fix_share == 0.0
    assert linked.rmse_m is not None and alone.rmse_m is not None and linked.rmse_m < alone.rmse_m
    assert records["", 1, "none"].rmse_m == records[WITHOUT_LINK, 1, "none"].rmse_m


def test_a_wrong_clock_of_the_link_costs_device_2_alone() -> None:
    records = {(one.condition, one.device): one.rmse_m for one in run() if one.filter == "none"}
    for condition in SHIFTS:
        assert records[condition, 1] == records["", 1]
        assert records[condition, 2] != records["", 2]


def test_a_device_may_be_asked_for_alone_and_is_scored_the_same() -> None:
    both, second = run(), run(request=replace(REQUEST, device="2"))
    keep = ("condition", "filter", "rmse_m", "n")
    assert [[getattr(one, name) for name in keep] for one in both if one.device == 2] == [
        [getattr(one, name) for name in keep] for one in second
    ]


def test_a_method_that_takes_no_other_device_gets_the_link_in_the_filter() -> None:
    conditions = {one.condition for one in run("cbt-wccg")}
    assert conditions == {WITHOUT_LINK, ALL_WITHOUT_LINK, RANGES_IN_FILTER, LINK_IN_FILTER}


def test_a_method_that_filters_itself_is_scored_without_the_link() -> None:
    assert {one.condition for one in run("bayes-grid")} == {WITHOUT_LINK, ALL_WITHOUT_LINK}


def test_tracks_hold_both_devices() -> None:
    laps = multi_device_tracks(made("nls"), REQUEST, Path())
    assert [one.lap.name for one in laps] == ["1", "2"]
    for one in laps:
        assert [track.recording.device for track in one.alone] == [1, 2]
        assert [track.recording.device for track in one.linked] == [1, 2]
        assert one.linked[1].unfiltered.fixed.sum() > one.alone[1].unfiltered.fixed.sum()
        assert [len(mask) for mask in one.is_linked] == [STEPS, STEPS]


def test_a_site_without_a_link_says_so(mall: SimpleNamespace) -> None:
    mall.device_links = mall.device_links.iloc[:0]
    with pytest.raises(FplocError, match="log of the link"):
        multi_device_records("nls", made("nls"), REQUEST, Path())


def test_hearing_only_leaves_nothing_of_other_access_points() -> None:
    given = recording(1, 2)
    found = hearing_only(given, (1, 3))
    np.testing.assert_array_equal(found.heard.any(axis=0), [False, True, False, True])
    for name in ("slant_m", "std_m", "rss_dbm"):
        np.testing.assert_array_equal(getattr(found, name)[:, [1, 3]], getattr(given, name)[:, [1, 3]])
        assert not getattr(found, name)[:, [0, 2]].any()


def test_summaries_take_mean_best_and_worst_and_leave_out_what_has_no_fix() -> None:
    one = run()[0]
    given = [
        replace(one, n=number, rmse_m=rmse) for number, rmse in ((4, 3.0), (8, 1.0), (6, 5.0), (0, None))
    ]
    mean, best, worst = summaries(given)
    assert (mean.condition, mean.n, mean.rmse_m) == (TWO_MEAN, 6, 3.0)
    assert (best.condition, best.n, best.rmse_m) == (TWO_BEST, 8, 1.0)
    assert (worst.condition, worst.n, worst.rmse_m) == (TWO_WORST, 6, 5.0)
    assert [each.rmse_m for each in summaries(given[3:])] == [None, None, None]
