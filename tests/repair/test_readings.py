from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from fploc.raw.lap import Lap
from fploc.repair.readings import drop_repeats, mend_readings


def lap_of(ranges: np.ndarray) -> Lap:
    """Return a lap whose ranges are shape (T, A), RSS −50 where there is a range."""
    sets, aps = ranges.shape
    readings = pd.DataFrame(
        {
            "set": np.repeat(np.arange(sets), aps),
            "mac": np.tile([f"mac{index}" for index in range(aps)], sets),
            "range_m": ranges.ravel(),
            "std_m": 0.1,
            "rss_dbm": np.where(ranges.ravel() > 0, -50.0, 0.0),
        }
    )
    return Lap(
        path=Path("lap"),
        sets=pd.DataFrame({"t_ms": 200.0 * np.arange(sets)}),
        readings=readings,
        is_slant=False,
    )


def test_neighbours_alike_in_range_and_rss_are_one() -> None:
    ranges = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.5], [1.0, 2.0], [0.0, 0.0], [0.0, 0.0], [0.0, 3.0]])
    lap, counts = drop_repeats(lap_of(ranges))
    assert lap.sets.index.tolist() == [0, 2, 3, 4, 6]
    assert sorted(lap.readings["set"].unique()) == [0, 2, 3, 4, 6]
    assert counts == {"repeated_sets": 2, "repeated_empty_sets": 1, "repeated_readings": 2}


@given(st.lists(st.integers(1, 7), min_size=1, max_size=20))
def test_repeating_rows_changes_nothing(times: list[int]) -> None:
    """A row grid that repeats each reading set up to 7 times gives back the reading sets."""
    sets = np.arange(1.0, len(times) + 1)[:, None] + [0.0, 0.5]
    repeated, counts = drop_repeats(lap_of(np.repeat(sets, times, axis=0)))
    np.testing.assert_array_equal(repeated.readings["range_m"].to_numpy().reshape(-1, 2), sets)
    assert counts["repeated_sets"] == sum(times) - len(times)


def test_zero_is_null_and_outliers_go() -> None:
    slant = np.array([0.0, 0.0, 13.7, 99.9, 100.0, 56425.0, -227.0, 60.0, 60.1, 5.0, 6.0])
    rss = np.array([0.0, -80.0, -60.0, -60.0, -60.0, -60.0, -50.0, -60.0, -60.0, 0.0, -127.0])
    readings = pd.DataFrame(
        {"range_slant_m": slant, "range_plan_m": slant, "range_std_m": 0.0, "rss_dbm": rss}
    )
    mended, counts = mend_readings(readings)
    assert mended.index.tolist() == [1, 2, 3, 6, 7, 8, 9, 10]
    assert mended["range_slant_m"].isna().tolist() == [True, False, False, True, False, False, False, False]
    assert mended["range_std_m"].isna().tolist() == mended["range_slant_m"].isna().tolist()
    assert mended["rss_dbm"].isna().tolist() == [False] * 6 + [True, True]
    assert mended["is_far"].tolist() == [False, False, True, False, False, True, False, False]
    assert counts == {
        "range_from_100m": 2,
        "range_missing": 2,
        "range_negative": 1,
        "rss_missing": 2,
        "far_beyond_60m": 2,
    }
