"""Studies: what is varied, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording
from fploc.evaluation.conditions import condition, varied
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.studies import DRAWS, Equipment, few, misplaced
from fploc.methods.registry import geometric_method
from rooms import room

PLACES = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (9.0, 6.0)]
SITE = room(PLACES, height_m=1.0)
STEPS = 40
REQUEST = EvaluationRequest("zero-shot", "box", calibration="none")


def recording() -> Recording:
    """Noise-free ranges along a straight walk; the last access point is heard half of the time."""
    t_s = 0.5 * np.arange(STEPS)
    path = np.column_stack([3.0 + 0.3 * t_s, 4.0 + 0.2 * t_s])
    heard = np.ones((STEPS, len(PLACES)), dtype=np.bool_)
    heard[::2, -1] = False
    ranges = np.where(heard, np.linalg.norm(path[:, None] - SITE.positions_m, axis=2), 0.0)
    return Recording(
        site="box",
        device=1,
        name="713",
        t_s=t_s,
        slant_m=ranges,
        std_m=np.where(heard, 0.1, 0.0),
        rss_dbm=np.where(heard, -60.0, 0.0),
        heard=heard,
        published_m=path,
        repaired_m=path,
    )


def equipment(method: str = "nls") -> Equipment:
    none = RangeOffsets("none", 0.0)
    return Equipment(method, geometric_method(method), none, SITE, [recording()], artifact=None)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_so_many_access_points_are_left_at_the_times_at_which_they_were_heard(count: int) -> None:
    whole = recording()
    (fewer,) = few(whole, count, draw=2)
    kept = fewer.heard.any(axis=0)
    assert kept.sum() == count
    np.testing.assert_array_equal(fewer.heard, whole.heard & kept)
    np.testing.assert_array_equal(fewer.slant_m, np.where(fewer.heard, whole.slant_m, 0.0))
    np.testing.assert_array_equal(fewer.repaired_m, whole.repaired_m)


def test_access_points_are_chosen_anew_in_each_draw_and_alike_when_repeated() -> None:
    chosen = [tuple(few(recording(), 3, draw)[0].heard.any(axis=0)) for draw in range(DRAWS)]
    assert len(set(chosen)) > 1
    assert chosen == [tuple(few(recording(), 3, draw)[0].heard.any(axis=0)) for draw in range(DRAWS)]


def test_a_recording_that_hears_fewer_is_left_out() -> None:
    assert few(recording(), 6, draw=0) == []
    assert equipment().with_fewer(REQUEST, [6, 7]) == []


def test_access_points_move_in_both_coordinates_within_the_error_and_keep_the_rest() -> None:
    moved = misplaced(SITE, 0.5, draw=0)
    off = moved.positions_m - SITE.positions_m
    assert (np.abs(off) <= 0.5).all() and (np.abs(off) > 0.0).all()
    assert moved.macs == SITE.macs
    np.testing.assert_array_equal(
        [one.height_m for one in moved.access_points], [one.height_m for one in SITE.access_points]
    )
    assert misplaced(SITE, 0.0, draw=0) == SITE
    assert misplaced(SITE, 0.5, draw=1) != moved


def test_noise_free_ranges_stay_exact_with_fewer_access_points_and_not_behind_a_wrong_survey() -> None:
    ready = equipment()
    unfiltered = {
        one.condition: one
        for one in [
            *ready.as_is(REQUEST),
            *ready.with_fewer(REQUEST, [4]),
            *ready.resurveyed(REQUEST, [0.0, 0.5]),
        ]
        if one.filter == "none" and one.labels == "published"
    }
    assert set(unfiltered) == {
        "access points: as they are",
        "access points: 4",
        "survey error: 0 m",
        "survey error: 0.5 m",
    }
    for name in ("access points: as they are", "access points: 4", "survey error: 0 m"):
        assert unfiltered[name].rmse_fixed_m == pytest.approx(0.0, abs=1e-5)
    wrong = unfiltered["survey error: 0.5 m"].rmse_fixed_m
    assert wrong is not None and 0.1 < wrong < 0.7
    assert unfiltered["access points: 4"].n == DRAWS * STEPS
    assert unfiltered["access points: as they are"].n == STEPS


def test_the_recordings_of_a_study_stay_as_they_were() -> None:
    ready = equipment()
    before = replace(ready.recordings[0])
    ready.with_fewer(REQUEST, [3])
    np.testing.assert_array_equal(ready.recordings[0].heard, before.heard)


def test_conditions_say_what_was_varied() -> None:
    assert varied(condition("calibration", "source-los")) == ("calibration", "source-los")
    assert varied("before fine-tuning") == ("", "")
    assert varied("") == ("", "")
