from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import calibrated_intervals, calibrated_plan_ranges, plan_ranges
from fploc.datasets.recordings import Recording
from fploc.intervals import Intervals
from fploc.sites.site import AccessPoint, Site

SITE = Site(
    name="hall",
    place="hall",
    access_points=(
        AccessPoint(name="AP1", mac="02:00:00:00:00:01", x_m=0.0, y_m=0.0, height_m=4.0),
        AccessPoint(name="AP2", mac="02:00:00:00:00:02", x_m=9.0, y_m=0.0, height_m=1.0),
    ),
    device_height_m=1.0,
)
RECORDING = Recording(
    site="hall",
    device=1,
    name="113",
    t_s=np.arange(3.0),
    slant_m=np.array([[7.0, 6.0], [4.0, 1.0], [0.0, 3.5]]),
    std_m=np.zeros((3, 2)),
    rss_dbm=np.full((3, 2), -50.0),
    heard=np.array([[True, True], [True, True], [False, True]]),
    published_m=np.zeros((3, 2)),
    repaired_m=np.zeros((3, 2)),
)


def test_height_is_taken_out_by_pythagoras() -> None:
    slant = torch.tensor([[5.0, 13.0, 2.0], [3.0, 5.0, 0.0]])
    heights = torch.tensor([3.0, -5.0, 0.0])
    torch.testing.assert_close(plan_ranges(slant, heights), torch.tensor([[4.0, 12.0, 2.0], [0.0, 0.0, 0.0]]))


def test_a_range_shorter_than_the_height_is_zero_in_the_plan() -> None:
    found = plan_ranges(torch.tensor([2.9, -4.0]), torch.tensor([3.0, 3.0]))
    assert found.tolist() == [0.0, 0.0]


def test_the_offset_is_subtracted_from_the_slant_range_before_the_height() -> None:
    found = calibrated_plan_ranges(RECORDING, SITE, RangeOffsets("2.0", 2.0))
    np.testing.assert_allclose(found, [[4.0, 4.0], [0.0, 0.0], [0.0, 1.5]])
    np.testing.assert_allclose(SITE.height_differences_m, [3.0, 0.0])


def test_offsets_act_on_their_own_access_point() -> None:
    offsets = RangeOffsets("source-mac", 1.0, {"02:00:00:00:00:02": 3.0})
    found = calibrated_plan_ranges(RECORDING, SITE, offsets)
    np.testing.assert_allclose(found[0], [np.sqrt(36.0 - 9.0), 3.0])


@pytest.mark.parametrize("offset_m", [0.0, -2.0])
def test_what_was_not_heard_stays_zero(offset_m: float) -> None:
    found = calibrated_plan_ranges(RECORDING, SITE, RangeOffsets("given", offset_m))
    assert found[2, 0] == 0.0


def test_the_recording_itself_is_left_alone() -> None:
    before = RECORDING.slant_m.copy()
    calibrated_plan_ranges(replace(RECORDING), SITE, RangeOffsets("2.0", 2.0))
    np.testing.assert_array_equal(RECORDING.slant_m, before)


def intervals(slant_m: list[float], rss_dbm: list[float]) -> Intervals:
    return calibrated_intervals(
        SITE,
        RangeOffsets("none", 0.0),
        t_s=torch.zeros(1),
        slant_m=torch.tensor([slant_m]),
        stds_m=torch.full((1, 2), 0.5),
        rss_dbm=torch.tensor([rss_dbm]),
        present=torch.tensor([True]),
    )


@pytest.mark.parametrize("slant_m", [0.0, -0.5, 100.0, 56425.0, math.nan, math.inf])
def test_what_is_no_range_was_not_heard(slant_m: float) -> None:
    found = intervals([slant_m, 6.0], [-50.0, -60.0])
    assert found.heard.tolist() == [[False, True]]
    assert [one[0, 0].item() for one in (found.ranges, found.stds, found.rss)] == [0.0, 0.0, 0.0]
    assert [one[0, 1].item() for one in (found.ranges, found.stds, found.rss)] == [6.0, 0.5, -60.0]


@pytest.mark.parametrize("rss_dbm", [0.0, -127.0, 3.0, math.nan])
def test_an_unknown_signal_strength_is_the_usual_one_of_its_range(rss_dbm: float) -> None:
    found = intervals([5.0, 10.0], [-45.0, rss_dbm])
    assert found.heard.all() and found.rss[0].tolist() == [-45.0, -60.0]
