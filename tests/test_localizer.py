from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import calibrated_plan_ranges, plan_ranges
from fploc.datasets.recordings import Recording
from fploc.filters.kalman import KalmanSettings
from fploc.intervals import Estimate, Intervals, NoFix, estimate
from fploc.localizer import Localizer, Track, localize
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.methods.one_shot import Memoryless, OneShotMethod
from fploc.methods.registry import GEOMETRIC_METHODS, geometric_method
from fploc.sites.site import AccessPoint, Site

SITE = Site(
    name="box",
    place="box",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 1.0 + index)
        for index, (x, y) in enumerate([(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)])
    ),
    device_height_m=1.0,
)
NONE = RangeOffsets("none", 0.0)
MEMORYLESS = [name for name in GEOMETRIC_METHODS if isinstance(geometric_method(name), Memoryless)]
SOLVERS = [name for name in MEMORYLESS if isinstance(geometric_method(name), OneShotMethod)]


def recording(steps: int, *, offset_m: float = 0.0, seed: int = 0, device: int = 1) -> Recording:
    random = np.random.default_rng(seed)
    t_s = np.cumsum(random.uniform(0.2, 0.7, steps))
    path = np.column_stack([5 + 0.3 * t_s, 4 + 0.1 * t_s])
    across = np.linalg.norm(path[:, None] - SITE.positions_m, axis=2)
    slant = np.hypot(across, SITE.height_differences_m) + offset_m
    heard = np.ones(slant.shape, dtype=bool)
    heard[steps // 2] = [True, True, False, False]
    blank = np.zeros(slant.shape)
    return Recording(
        site="box",
        device=device,
        name=f"lap{seed}",
        t_s=t_s,
        slant_m=np.where(heard, slant, 0.0),
        std_m=blank,
        rss_dbm=blank,
        heard=heard,
        published_m=path,
        repaired_m=path,
    )


@dataclass
class InTurn:
    """A memoryless method that does not say so, and counts the steps of its state."""

    name: str
    steps: int = 0

    def init(self, site: Site, devices: int) -> Tensor:
        self.inner = geometric_method(self.name)
        self.access_points = self.inner.init(site, devices)
        return torch.zeros(devices)

    def step(self, state: Tensor, intervals: Intervals) -> tuple[Tensor, Estimate]:
        self.steps += 1
        return state + intervals.present, self.inner.step(self.access_points, intervals)[1]


@dataclass
class StepCounter:
    """Answers with the number of intervals that each device has had in its recording."""

    name: str = "counter"

    def init(self, site: Site, devices: int) -> Tensor:
        return torch.zeros(devices, dtype=torch.float64)

    def step(self, state: Tensor, intervals: Intervals) -> tuple[Tensor, Estimate]:
        state = state + intervals.present
        spread = torch.eye(2, dtype=torch.float64).expand(len(state), 2, 2)
        fixed = torch.zeros(len(state), dtype=torch.int64)
        return state, estimate(torch.stack([state, state], -1), spread, fixed)


@pytest.mark.parametrize("name", SOLVERS)
def test_noise_free_recordings_come_back_as_their_path(name: str) -> None:
    laps = [recording(30, seed=1), recording(17, seed=2)]
    for track, lap in zip(localize(geometric_method(name), SITE, laps, NONE, None), laps, strict=True):
        assert track.filtered is None and track.recording is lap
        middle = len(lap) // 2
        assert track.unfiltered.reasons[middle] == NoFix.TOO_FEW_RANGES
        assert track.unfiltered.fixed.sum() == len(lap) - 1
        fixed = track.unfiltered.fixed
        np.testing.assert_allclose(track.unfiltered.positions_m[fixed], lap.repaired_m[fixed], atol=1e-6)


@pytest.mark.parametrize("name", MEMORYLESS)
def test_all_at_once_equals_one_after_the_other(name: str) -> None:
    laps = [recording(40, offset_m=0.7, seed=1), recording(23, offset_m=1.3, seed=2)]
    together = localize(geometric_method(name), SITE, laps, NONE, KalmanSettings())
    counted = InTurn(name)
    in_turn = localize(counted, SITE, laps, NONE, KalmanSettings())
    assert counted.steps == 40
    for one, other in zip(together, in_turn, strict=True):
        np.testing.assert_allclose(one.unfiltered.positions_m, other.unfiltered.positions_m, atol=1e-9)
        np.testing.assert_array_equal(one.unfiltered.reasons, other.unfiltered.reasons)
        assert one.filtered is not None and other.filtered is not None
        np.testing.assert_allclose(one.filtered.positions_m, other.filtered.positions_m, atol=1e-9)


def test_state_starts_anew_with_each_recording_and_stops_at_its_end() -> None:
    laps = [recording(12, seed=1), recording(5, seed=2)]
    method = StepCounter()
    for _ in range(2):
        first, second = localize(method, SITE, laps, NONE, None)
        assert first.unfiltered.positions_m[:, 0].tolist() == list(range(1, 13))
        assert second.unfiltered.positions_m[:, 0].tolist() == list(range(1, 6))


def test_a_recording_gives_the_same_track_alone_and_in_company() -> None:
    laps = [recording(40, seed=1), recording(23, seed=2)]
    alone: list[Track] = [
        localize(geometric_method("nls"), SITE, [lap], NONE, KalmanSettings())[0] for lap in laps
    ]
    for one, other in zip(
        alone, localize(geometric_method("nls"), SITE, laps, NONE, KalmanSettings()), strict=True
    ):
        assert one.filtered is not None and other.filtered is not None
        np.testing.assert_allclose(one.filtered.positions_m, other.filtered.positions_m, atol=1e-9)
        np.testing.assert_allclose(one.filtered.covariances_m2, other.filtered.covariances_m2, atol=1e-9)


def test_offsets_come_off_the_slant_range_before_the_projection() -> None:
    lap = recording(20, offset_m=1.7)
    offsets = RangeOffsets("1.7", 1.7)
    (track,) = localize(geometric_method("nls"), SITE, [lap], offsets, None)
    fixed = track.unfiltered.fixed
    np.testing.assert_allclose(track.unfiltered.positions_m[fixed], lap.repaired_m[fixed], atol=1e-6)
    across = np.linalg.norm(lap.repaired_m[:, None] - SITE.positions_m, axis=2)
    expected = np.where(lap.heard, across, 0.0)
    np.testing.assert_allclose(calibrated_plan_ranges(lap, SITE, offsets), expected, atol=1e-9)


def test_a_range_below_the_height_difference_is_none_in_the_plan() -> None:
    heights = torch.tensor([2.0, 2.0, 2.0])
    found = plan_ranges(torch.tensor([-1.0, 1.0, 2.5]), heights)
    torch.testing.assert_close(found, torch.tensor([0.0, 0.0, 1.5]))


def reported(localizer: Localizer, lap: Recording, step: int) -> Intervals:
    """Return one interval of a recording as its device sends it."""
    at = slice(step, step + 1)
    return localizer.calibrated(
        *(torch.from_numpy(one[at]) for one in (lap.t_s, lap.slant_m, lap.std_m, lap.rss_dbm))
    )


def test_the_live_localizer_says_what_the_offline_one_says() -> None:
    lap = recording(25, offset_m=0.5)
    (track,) = localize(geometric_method("nls"), SITE, [lap], NONE, KalmanSettings())
    assert track.filtered is not None
    live = Localizer(geometric_method("nls"), SITE, NONE, KalmanSettings())
    state = live.init(1)
    for step in range(len(lap)):
        state, found = live.advance(state, reported(live, lap, step))
        np.testing.assert_allclose(found.positions[0], track.filtered.positions_m[step], atol=1e-9)


def test_a_device_without_any_reading_has_no_fix_and_no_error() -> None:
    lap = recording(9)
    silent = replace(lap, heard=np.zeros_like(lap.heard), slant_m=np.zeros_like(lap.slant_m))
    (track,) = localize(geometric_method("nls"), SITE, [silent], NONE, KalmanSettings())
    assert track.filtered is not None
    assert set(track.filtered.reasons) == {int(NoFix.NO_READING)}
    assert np.isnan(track.filtered.positions_m).all()


def test_refining_all_rows_together_equals_stepping_through_time(untrained_chain: GNNFPDNN) -> None:
    laps = [recording(40, seed=1), recording(25, seed=2, device=2)]
    together = localize(untrained_chain, SITE, laps, NONE, KalmanSettings())
    for track in together:
        localizer = Localizer(untrained_chain, SITE, NONE, KalmanSettings())
        state = localizer.init(1)
        one = track.recording
        for step in range(len(one)):
            state, found = localizer.advance(state, reported(localizer, one, step))
            assert track.filtered is not None
            np.testing.assert_allclose(
                found.positions[0].numpy(), track.filtered.positions_m[step], atol=1e-4, equal_nan=True
            )
