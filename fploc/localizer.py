"""Readings in, position and covariance out: offline evaluation and a live server both go through here.

A ``Localizer`` is advanced one interval at a time for a batch of devices; ``localize`` runs whole recordings
through it. Range offsets are subtracted from slant ranges, and only then are these projected to the plan.

Axes: B recordings, T time, A access points.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import calibrated_intervals, recorded_intervals
from fploc.datasets.recordings import Recording
from fploc.filters.kalman import BatchedFilter, KalmanSettings, KalmanState
from fploc.filters.smoother import smoothed
from fploc.intervals import Estimate, Intervals, NoFix, stacked
from fploc.methods.interface import Filtering, Method, Refining, Smoothing, Solving
from fploc.methods.one_shot import Memoryless
from fploc.progress import track
from fploc.sites.site import Site

ROWS_AT_ONCE = 4096
"""Intervals that a memoryless method solves in one call: bounds memory, not results."""


@dataclass(frozen=True)
class Path:
    """Positions of one recording.

    Args:
        positions_m: Shape (T, 2), metres, site frame; NaN where there is no fix.
        covariances_m2: Shape (T, 2, 2), square metres; NaN where there is no fix.
        reasons: ``NoFix`` of each interval, shape (T,).
        ms_per_fix: Time that an interval of its batch took, milliseconds.
    """

    positions_m: NDArray[np.float64]
    covariances_m2: NDArray[np.float64]
    reasons: NDArray[np.int64]
    ms_per_fix: float

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """True where there is a position, shape (T,)."""
        fixed: NDArray[np.bool_] = self.reasons == NoFix.FIXED
        return fixed


@dataclass(frozen=True)
class Track:
    """What a method made of one recording, before and after the filter.

    Args:
        recording: The readings it was made from.
        unfiltered: The method's own fixes.
        filtered: After the Kalman filter, whose time is added; None where no filter was asked for.
        own_filter: True where the method's own fixes went through a filter of its own.
    """

    recording: Recording
    unfiltered: Path
    filtered: Path | None
    own_filter: bool

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Device time, shape (T,), seconds."""
        return self.recording.t_s

    @property
    def once_filtered(self) -> Path:
        """What a filter made: the method's own where it has one, since it needs none behind it."""
        return self.unfiltered if self.own_filter or self.filtered is None else self.filtered


@dataclass(frozen=True)
class LocalizerState:
    """State of the method and of the filter behind it, for a batch of devices; no tracks without a filter."""

    method: Any
    tracks: KalmanState | None


class Localizer:
    """A method at a site, with its range offsets and a filter behind it.

    Args:
        method: Turns calibrated intervals into positions.
        site: Where the devices are.
        offsets: Subtracted from slant ranges.
        filter_settings: Of the Kalman filter; None for the method's fixes alone.
    """

    def __init__(
        self,
        method: Method,
        site: Site,
        offsets: RangeOffsets,
        filter_settings: KalmanSettings | None = None,
    ) -> None:
        self.method = method
        self.site = site
        self.offsets = offsets
        self.filter = None if filter_settings is None else BatchedFilter(filter_settings)

    def with_method(self, method: Method) -> Localizer:
        """Return a localizer of another method at the same site, without a filter behind it."""
        return Localizer(method, self.site, self.offsets)

    def init(self, devices: int) -> LocalizerState:
        """Return the state of ``devices`` devices before their first interval."""
        tracks = None if self.filter is None else self.filter.init(devices)
        return LocalizerState(self.method.init(self.site, devices), tracks)

    def calibrated(self, t_s: Tensor, slant_m: Tensor, stds_m: Tensor, rss_dbm: Tensor) -> Intervals:
        """Return what devices report, all of them present, as intervals.

        Args:
            t_s: Device time, shape (B,), seconds.
            slant_m: Slant ranges, shape (B, A), metres; 0 where there is none.
            stds_m: Spread of each, shape (B, A), metres; 0 where unknown.
            rss_dbm: Received signal strength, shape (B, A), dBm; 0 where unknown.
        """
        return calibrated_intervals(
            self.site,
            self.offsets,
            t_s=t_s,
            slant_m=slant_m,
            stds_m=stds_m,
            rss_dbm=rss_dbm,
            present=torch.ones(len(t_s), dtype=torch.bool),
        )

    def advance(self, state: LocalizerState, intervals: Intervals) -> tuple[LocalizerState, Estimate]:
        """Advance every device that is present by one interval.

        Args:
            state: Of the devices.
            intervals: With calibrated ranges (``calibrated``).

        Returns:
            The new state and the estimate, filtered where there is a filter.
        """
        state, found = self.locate(state, intervals)
        return self.filtered(state, intervals, found)

    def locate(self, state: LocalizerState, intervals: Intervals) -> tuple[LocalizerState, Estimate]:
        """Advance the method alone."""
        method_state, found = self.method.step(state.method, intervals)
        return replace(state, method=method_state), found

    def filtered(
        self, state: LocalizerState, intervals: Intervals, found: Estimate
    ) -> tuple[LocalizerState, Estimate]:
        """Advance the filter alone by what the method found; without a filter that is the estimate."""
        if self.filter is None or state.tracks is None:
            return state, found
        tracks, filtered = self.filter.step(state.tracks, intervals.t_s, intervals.present, found)
        return replace(state, tracks=tracks), filtered


def localize(
    method: Method,
    site: Site,
    recordings: Sequence[Recording],
    offsets: RangeOffsets,
    filter_settings: KalmanSettings | None,
) -> list[Track]:
    """Run a method over recordings, all at once and each from a fresh state.

    Args:
        method: The method; one that declares itself ``Memoryless`` is given many intervals per call.
        site: Where the recordings were made.
        recordings: At least one.
        offsets: Range offsets to remove.
        filter_settings: Of the Kalman filter on the method's fixes; None for none.

    Returns:
        One track for each recording, in their order.
    """
    localizer = Localizer(method, site, offsets, filter_settings)
    intervals = recorded_intervals(recordings, site, offsets)
    count = int(intervals.present.sum())
    with torch.inference_mode():
        started = time.perf_counter()
        found = _locate(localizer, intervals)
        located = time.perf_counter()
        filtered = (
            None
            if localizer.filter is None
            else localizer.filter.run(intervals.t_s, intervals.present, found)
        )
        done = time.perf_counter()
    tracks = []
    for index, recording in enumerate(recordings):
        length = len(recording)
        unfiltered = path_of(found, index, length, ms_per_fix=1000.0 * (located - started) / count)
        own = None
        if filtered is not None:
            own = path_of(filtered, index, length, ms_per_fix=1000.0 * (done - started) / count)
        tracks.append(Track(recording, unfiltered, own, own_filter=isinstance(method, Filtering)))
    return tracks


def localize_offline(
    method: Method,
    site: Site,
    recordings: Sequence[Recording],
    offsets: RangeOffsets,
    filter_settings: KalmanSettings,
) -> list[Track]:
    """Run a method over recordings whose ends are known: every position is smoothed by what came after it.

    ``filtered`` are the method's fixes through the Kalman smoother. ``unfiltered`` are those of a method that is
    a smoother itself, and the fixes as they are of every other one, which says so by ``own_filter``.

    Arguments are those of ``localize``.
    """
    localizer = Localizer(method, site, offsets, filter_settings)
    assert localizer.filter is not None
    intervals = recorded_intervals(recordings, site, offsets)
    count = int(intervals.present.sum())
    with torch.inference_mode():
        started = time.perf_counter()
        if isinstance(method, Smoothing):
            found, shown = method.both_ways(site, intervals)
        else:
            found = shown = _locate(localizer, intervals)
        filtered = smoothed(localizer.filter, intervals, found)
    ms_per_fix = 1000.0 * (time.perf_counter() - started) / count
    return [
        Track(
            recording,
            path_of(shown, index, len(recording), ms_per_fix=ms_per_fix),
            path_of(filtered, index, len(recording), ms_per_fix=ms_per_fix),
            own_filter=isinstance(method, Smoothing),
        )
        for index, recording in enumerate(recordings)
    ]


def _locate(localizer: Localizer, intervals: Intervals) -> Estimate:
    """Run the method over all intervals, many at once where it allows that; estimates have shape (T, B, …)."""
    method = localizer.method
    if isinstance(method, Memoryless):
        return _locate_together(localizer, intervals)
    if isinstance(method, Refining):
        return _locate_in_stages(localizer, method, intervals)
    if isinstance(method, Solving):
        return _solve_together(localizer, method, intervals)
    return _locate_in_turn(localizer, intervals)


def _locate_in_stages(localizer: Localizer, method: Refining, intervals: Intervals) -> Estimate:
    """Find coarse positions all together, filter them through time, refine them all together again."""
    steps, devices = intervals.t_s.shape
    coarse = localizer.with_method(method.coarse)
    found = _locate_together(coarse, intervals)
    filtered = method.filter.run(intervals.t_s, intervals.present, found)
    access_points = method.coarse.init(localizer.site, devices)
    rows = flat(intervals)
    coarse_rows = Estimate(
        filtered.positions.flatten(0, 1), filtered.covariances.flatten(0, 1), filtered.reasons.flatten()
    )
    refined = []
    for at in track(
        chunks(steps * devices, method.rows_at_once(len(localizer.site.access_points))), method.name
    ):
        coarse_chunk = Estimate(
            coarse_rows.positions[at], coarse_rows.covariances[at], coarse_rows.reasons[at]
        )
        refined.append(method.refine(access_points, rows.at(at), coarse_chunk))
    return joined(refined, steps, devices)


def _solve_together(localizer: Localizer, method: Solving, intervals: Intervals) -> Estimate:
    """Follow links through time, solve for all positions together."""
    steps, devices = intervals.t_s.shape
    state = method.init(localizer.site, devices)
    followed = []
    for step in range(steps):
        state, one = method.follow(state, intervals.at(step))
        followed.append(one)
    rows = {
        field.name: torch.cat([getattr(one, field.name) for one in followed]) for field in fields(followed[0])
    }
    solved = [
        method.solve(state.access_points, type(followed[0])(**{name: rows[name][at] for name in rows}))
        for at in chunks(steps * devices, ROWS_AT_ONCE)
    ]
    return joined(solved, steps, devices)


def _locate_together(localizer: Localizer, intervals: Intervals) -> Estimate:
    """Locate every interval of every recording as one batch; estimates have shape (T, B, …)."""
    steps, devices = intervals.t_s.shape
    rows = flat(intervals)
    found = []
    for at in chunks(steps * devices, ROWS_AT_ONCE):
        chunk = rows.at(at)
        found.append(localizer.locate(localizer.init(len(chunk.t_s)), chunk)[1])
    return joined(found, steps, devices)


def chunks(rows: int, at_once: int) -> list[slice]:
    """Return slices that cover ``rows``."""
    return [slice(start, start + at_once) for start in range(0, rows, at_once)]


def flat(intervals: Intervals) -> Intervals:
    """Return intervals (T, B, …) as rows (T · B, …)."""
    return Intervals(
        t_s=intervals.t_s.flatten(),
        ranges=intervals.ranges.flatten(0, 1),
        stds=intervals.stds.flatten(0, 1),
        rss=intervals.rss.flatten(0, 1),
        heard=intervals.heard.flatten(0, 1),
        present=intervals.present.flatten(),
    )


def joined(chunks: Sequence[Estimate], steps: int, devices: int) -> Estimate:
    """Return estimates of chunks of rows as one of shape (T, B, …)."""
    return Estimate(
        positions=torch.cat([one.positions for one in chunks]).reshape(steps, devices, 2),
        covariances=torch.cat([one.covariances for one in chunks]).reshape(steps, devices, 2, 2),
        reasons=torch.cat([one.reasons for one in chunks]).reshape(steps, devices),
    )


def _locate_in_turn(localizer: Localizer, intervals: Intervals) -> Estimate:
    """Step the method through time; estimates have shape (T, B, …)."""
    state = localizer.init(intervals.t_s.shape[1])
    found = []
    for step in track(range(len(intervals.t_s)), localizer.method.name):
        state, one = localizer.locate(state, intervals.at(step))
        found.append(one)
    return stacked(found)


def path_of(found: Estimate, index: int, length: int, *, ms_per_fix: float) -> Path:
    """Return the path of one recording out of a batch."""
    return Path(
        positions_m=found.positions[:length, index].double().cpu().numpy(),
        covariances_m2=found.covariances[:length, index].double().cpu().numpy(),
        reasons=found.reasons[:length, index].cpu().numpy(),
        ms_per_fix=ms_per_fix,
    )
