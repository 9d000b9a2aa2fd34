from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError, UnknownNameError
from fploc.repair.labels import (
    Labels,
    corner_times,
    delayed_lap,
    moved_seam,
    repair_labels,
    shift,
    stretched_leg,
)
from fploc.sites.registry import RepairSpec, load_spec

SEAM = load_spec("office").repairs["seam"]


def labels_of(positions_m: object, t_s: object = None, recording: str = "lap") -> Labels:
    positions = np.asarray(positions_m, dtype=np.float64)
    times = np.arange(len(positions), dtype=np.float64) if t_s is None else np.asarray(t_s)
    return Labels(
        recording=recording, t_s=times, positions_m=positions, keep=np.ones(len(positions), dtype=bool)
    )


def loop(step_m: float = 0.01) -> np.ndarray:
    """The office's loop with sharp corners, from the labelled seam."""
    corners = np.array(
        [
            [31, 13.75],
            [47.75, 13.75],
            [48.5, 13.0],
            [48.5, 6.3],
            [17.2, 6.3],
            [17.2, 13],
            [18.1, 13.75],
            [31, 13.75],
        ]
    )
    arc = np.r_[0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    at = np.arange(0, arc[-1], step_m)
    return np.stack([np.interp(at, arc, corners[:, axis]) for axis in (0, 1)], axis=1)


def test_moved_seam_follows_its_formula_and_leaves_the_rest() -> None:
    published = loop()
    moved = moved_seam(labels_of(published), **SEAM.constants).positions_m
    top = published[:, 1] >= 13.749
    first = top & (np.arange(len(top)) < len(top) // 2)
    last = top & ~first
    x = published[:, 0]
    np.testing.assert_allclose(moved[first, 0], 35.35 + (x[first] - 31) * (47.45 - 35.35) / 16.75, atol=0.02)
    np.testing.assert_allclose(moved[last, 0], 17.6 + (x[last] - 18.1) * (35.35 - 17.6) / 12.9, atol=0.02)
    below = published[:, 1] < 10
    np.testing.assert_array_equal(moved[below], published[below])
    steps = np.linalg.norm(np.diff(moved, axis=0), axis=1)
    assert steps.max() < 0.4, "no jump much beyond the repaired label's own error of 0.3 m"
    assert np.abs(moved - published).max() == pytest.approx(4.35, abs=0.01)


def test_delayed_lap_spreads_the_polyline_over_its_own_time() -> None:
    t_s = np.linspace(0.0, 100.0, 101)
    repaired = delayed_lap(
        labels_of(np.stack([t_s, 0 * t_s], axis=1), t_s), first_row=60, start_s=60.0, duration_s=40.0
    )
    assert repaired.keep.tolist() == [False] * 60 + [True] * 41
    np.testing.assert_allclose(repaired.positions_m[60:, 0], np.linspace(0.0, 100.0, 41))


def test_stretched_leg_puts_the_sign_right() -> None:
    moved = stretched_leg(
        labels_of([[13.46, 0.54], [9.0, 3.14], [4.3, 5.74]]),
        below_y_m=5.739,
        fixed_y_m=5.74,
        true_length_m=6.28,
        labelled_length_m=5.20,
    ).positions_m
    np.testing.assert_allclose(moved, [[13.46, -0.54], [9.0, 2.6], [4.3, 5.74]])


def test_corner_times_pass_every_corner_on_time() -> None:
    repaired = corner_times(
        labels_of(np.full((5, 2), np.nan), [0.0, 10.0, 15.0, 30.0, 50.0]),
        start_m=[0, 0],
        corners_m=[[0, 4], [8, 4], [8, 0]],
        turns_s={"lap": [10, 30, 40, 50]},
    )
    np.testing.assert_allclose(repaired.positions_m, [[0, 0], [0, 4], [2, 4], [8, 4], [0, 0]])


def test_shifted_labels_all_move_by_one_vector() -> None:
    moved = shift(labels_of([[1.0, 2.0], [np.nan, np.nan], [-3.0, 0.5]]), x_m=0.25, y_m=-1.0)
    np.testing.assert_array_equal(moved.positions_m, [[1.25, 1.0], [np.nan, np.nan], [-2.75, -0.5]])
    assert moved.keep.all() and moved.recording == "lap"


def test_bad_constants_are_named() -> None:
    labels = labels_of([[0.0, 0.0]])
    with pytest.raises(UnknownNameError, match="repair wand, kind: found 'magic', expected one of"):
        repair_labels(labels, RepairSpec("wand", "magic", {}, "made up"))
    with pytest.raises(FplocError, match="repair nudge, constants: found x_m, expected x_m, y_m"):
        repair_labels(labels, RepairSpec("nudge", "shift", {"x_m": 1.0}, "made up"))
    with pytest.raises(UnknownNameError, match="turns_s: found 'lap'"):
        corner_times(labels, start_m=[0, 0], corners_m=[[1, 0]], turns_s={"other": [1, 2]})
    with pytest.raises(FplocError, match="turns_s of lap: found 1 times, expected 2"):
        corner_times(labels, start_m=[0, 0], corners_m=[[1, 0]], turns_s={"lap": [1]})


@pytest.fixture(scope="module")
def office(data_root: Path) -> PackedSite:
    return read_packed(data_root, "office")


def excess_m(packed: PackedSite, recording: Recording, kind: str) -> np.ndarray:
    """Range minus true distance in space, shape (T, A); NaN where there is no range."""
    offset = recording.labels_m(kind)[:, None] - packed.site.positions_m
    distance = np.sqrt((offset**2).sum(-1) + packed.site.height_differences_m**2)
    return np.where(recording.heard, recording.slant_m - distance, np.nan)


def test_line_of_sight_spread_on_the_top_edge_falls(office: PackedSite) -> None:
    """AP1 to AP4 hang along the top edge: spread about 2.0 m as published, 0.5 m after the repair."""
    spread = {}
    for kind in ("published", "repaired"):
        values = []
        for recording in office.recordings():
            excess = excess_m(office, recording, kind)[recording.published_m[:, 1] > 13.749, :4]
            excess = excess[:, ~np.isnan(excess).all(axis=0)]
            values.append(1.4826 * np.nanmedian(np.abs(excess - np.nanmedian(excess, axis=0)), axis=0).mean())
        spread[kind] = values
    full_laps = [0, 1, 3, 4]
    assert all(1.9 < spread["published"][lap] < 2.3 for lap in full_laps), spread
    assert all(0.4 < value < 0.6 for value in spread["repaired"]), spread


def test_impossible_samples_nearly_vanish(office: PackedSite) -> None:
    """Ranges shorter than the distance by over 1.5 m: about 1,000 a lap as published, 15 after the repair."""
    counts = {
        kind: [int((excess_m(office, recording, kind) < -1.5).sum()) for recording in office.recordings()]
        for kind in ("published", "repaired")
    }
    full_laps = [0, 1, 3, 4]
    assert all(850 < counts["published"][lap] < 1200 for lap in full_laps), counts
    assert all(5 <= count <= 20 for count in counts["repaired"]), counts


def test_delayed_conference_lap_has_two_impossible_samples_left(data_root: Path) -> None:
    packed = read_packed(data_root, "conference-room")
    lap = next(recording for recording in packed.recordings() if recording.name == "213")
    assert len(lap) > 800 and lap.t_s[-1] == pytest.approx(263.4, abs=2.0)
    assert (excess_m(packed, lap, "published") < -1.5).sum() > 500
    assert (excess_m(packed, lap, "repaired") < -1.5).sum() == 2


def test_mall_lap_starts_at_the_corner_point(data_root: Path) -> None:
    packed = read_packed(data_root, "shopping-mall")
    lap = next(recording for recording in packed.recordings() if recording.name == "924")
    np.testing.assert_allclose(lap.repaired_m[0], [13.46, -0.54], atol=1e-6)
    other = next(recording for recording in packed.recordings() if recording.name == "724")
    np.testing.assert_array_equal(other.repaired_m, other.published_m)


@pytest.mark.parametrize("name", ["office-position1", "office-position2"])
def test_reconstructed_labels_fit_the_ranges(data_root: Path, name: str) -> None:
    """No label is published here; each AP's range follows the distance to its own coordinates best."""
    packed = read_packed(data_root, name)
    recordings = packed.recordings()
    for recording in recordings:
        assert np.isnan(recording.published_m).all() and not np.isnan(recording.repaired_m).any()
        excess = excess_m(packed, recording, "repaired")
        assert 1.0 < np.nanmedian(excess) < 2.0
        assert (excess < -1.5).sum() < 40
    recording = recordings[0]
    distance = np.linalg.norm(recording.repaired_m[:, None] - packed.site.positions_m, axis=2)
    ranges = np.where(recording.heard, recording.slant_m, np.nan)
    against_all = ranges[:, :, None] - distance[:, None, :]
    spread = np.nanmedian(np.abs(against_all - np.nanmedian(against_all, axis=0)), axis=0)
    assert spread.argmin(axis=1).tolist() == list(range(8))
