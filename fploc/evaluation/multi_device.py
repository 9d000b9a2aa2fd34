"""Two devices at once, with the link between them (protocol ``multi-device``).

Records say in ``condition`` what differs. Those with and without the link are over the same intervals: those at
which a reading of the link and an interval of the other device stand beside, young enough to be used. The last fix
is held there from wherever it was made.

====================================  ====================================================================
``""``                                both devices, all access points, with the link
``without link``                      the same intervals without it
``all intervals``                     whole recordings, the link used where it is there
``all intervals, without link``       whole recordings without it
``link in the filter``                the link enters the Kalman filter as a range, and so do the ranges of
                                      intervals with too few of them for a fix
``ranges in the filter``              the latter alone: what of it is not the link's
``two APs, mean`` (best, worst)       device 2 given two access points, over all pairs of those it hears
``link clock +5 s`` (−)               the link's clock set forward (back)
``device 2 clock +5 s`` (−)           the clock of device 2 set forward (back)
====================================  ====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.paired import NO_LINK, PairedLap, paired_laps
from fploc.datasets.recordings import Bools, Recording
from fploc.errors import FplocError
from fploc.evaluation.evaluate import EvaluationRequest, records_of
from fploc.evaluation.metrics import COUNTS
from fploc.evaluation.records import KALMAN, Record
from fploc.filters.kalman import KalmanSettings
from fploc.joint_localizer import (
    Beside,
    DeviceLinkSettings,
    company,
    is_joint,
    joint_tracks,
    ranged_tracks,
)
from fploc.localizer import Track, localize
from fploc.methods.interface import Filtering, Method
from fploc.sites.site import Site

WITHOUT_LINK = "without link"
ALL_INTERVALS = "all intervals"
ALL_WITHOUT_LINK = "all intervals, without link"
LINK_IN_FILTER = "link in the filter"
RANGES_IN_FILTER = "ranges in the filter"
TWO_MEAN, TWO_BEST, TWO_WORST = "two APs, mean", "two APs, best", "two APs, worst"
CLOCK_SHIFT_S = 5.0
SHIFTS: Mapping[str, Mapping[str, float]] = {
    "link clock +5 s": {"link_s": CLOCK_SHIFT_S},
    "link clock -5 s": {"link_s": -CLOCK_SHIFT_S},
    "device 2 clock +5 s": {"second_s": CLOCK_SHIFT_S},
    "device 2 clock -5 s": {"second_s": -CLOCK_SHIFT_S},
}
METRICS = (
    "no_fix_share", "rmse_m", "rmse_fixed_m", "mae_m", "p50_m", "p90_m", "p95_m", "coverage95", "nees",
)  # fmt: skip


class Ready(Protocol):
    """A method that can run at its target, as ``fploc.experiments.scoring.ReadyMethod``."""

    @property
    def method(self) -> Method:
        """The method."""

    @property
    def offsets(self) -> RangeOffsets:
        """Range offsets to remove first."""

    @property
    def artifact(self) -> str | None:
        """Name of what was trained; None where nothing was."""


@dataclass(frozen=True, eq=False)
class LapTracks:
    """What a method made of one lap of both devices, device 1 first.

    Args:
        lap: The lap.
        alone: Tracks without the link.
        linked: Tracks with it; those without where the method takes no other device.
        is_linked: True where a reading of the link and an interval of the other device stand beside an
            interval, shape (T,) for each device.
    """

    lap: PairedLap
    alone: tuple[Track, Track]
    linked: tuple[Track, Track]
    is_linked: tuple[Bools, Bools]


@dataclass(frozen=True)
class _Run:
    """How a method is run: all arguments that its runs share."""

    method: Method
    site: Site
    offsets: RangeOffsets
    filter_settings: KalmanSettings
    settings: DeviceLinkSettings

    def alone(self, recordings: Sequence[Recording]) -> list[Track]:
        """Return the tracks of devices without another."""
        return localize(self.method, self.site, recordings, self.offsets, self.filter_settings)

    def joint(self, pairs: Sequence[Beside]) -> list[Track]:
        """Return the tracks of devices with another; those alone where the method takes none."""
        if not is_joint(self.method):
            return [pair.own for pair in pairs]
        return joint_tracks(self.method, self.site, pairs, self.offsets, self.filter_settings, self.settings)

    def ranged(self, pairs: Sequence[Beside]) -> list[Track]:
        """Return the tracks of devices with ranges in the filter."""
        return ranged_tracks(self.site, pairs, self.offsets, self.filter_settings, self.settings)


def multi_device_tracks(ready: Ready, request: EvaluationRequest, data_root: Path) -> list[LapTracks]:
    """Run a method over all laps of both devices, without and with the link between them.

    Args:
        ready: The method.
        request: What is asked; its device is left aside.
        data_root: Folder of packed sites.

    Raises:
        FplocError: If an option cannot be used, the data are not there, or there is no link in them.
    """
    target = _target(request, data_root)
    return _lap_tracks(_run(ready, request, target.site), _laps(target, request))


def multi_device_records(
    name: str, ready: Ready, request: EvaluationRequest, data_root: Path
) -> list[Record]:
    """Run and score a method on both devices at once, under every condition above.

    A method that takes no other device is scored without the link and with it in the filter. One that is a
    filter itself has no such filter behind it, and is scored without the link alone.

    Args:
        name: As it is to stand in the records.
        ready: The method.
        request: What is asked; its device says of which device records are returned, both are run.
        data_root: Folder of packed sites.

    Raises:
        FplocError: As ``multi_device_tracks``.
    """
    target = _target(request, data_root)
    run = _run(ready, request, target.site)
    laps = _lap_tracks(run, _laps(target, request))
    scored = _Scored(name, request, ready.artifact)
    records = [
        *scored.records(_both(laps, "alone"), WITHOUT_LINK, _linked_masks(laps)),
        *scored.records(_both(laps, "alone"), ALL_WITHOUT_LINK),
    ]
    if is_joint(run.method):
        records += scored.records(_both(laps, "linked"), "", _linked_masks(laps))
        records += scored.records(_both(laps, "linked"), ALL_INTERVALS)
        for condition, shift in SHIFTS.items():
            tracks = run.joint([pair for lap in laps for pair in _pairs(_shifted(lap, shift), lap.alone)])
            records += scored.records(tracks, condition, _linked_masks(laps))
        records += _two_access_points(run, laps, scored)
    if not isinstance(run.method, Filtering):
        records += _ranged_records(run, laps, scored)
    return [one for one in records if request.device in ("all", str(one.device))]


@dataclass(frozen=True)
class _Scored:
    """Turns tracks into records of one method."""

    name: str
    request: EvaluationRequest
    artifact: str | None

    def records(
        self, tracks: Sequence[Track], condition: str, masks: Sequence[Bools] | None = None
    ) -> list[Record]:
        """Return the records of tracks, over the intervals of ``masks``; None for all of them."""
        chosen = (
            tracks
            if masks is None
            else [
                replace(track, recording=labelled_at(track.recording, mask))
                for track, mask in zip(tracks, masks, strict=True)
            ]
        )
        made = records_of(self.name, self.request, chosen, artifact=self.artifact)
        return [replace(one, condition=condition) for one in made]


def labelled_at(recording: Recording, mask: Bools) -> Recording:
    """Return a recording without the labels of other intervals than those of a mask, shape (T,)."""
    return replace(
        recording,
        published_m=np.where(mask[:, None], recording.published_m, np.nan),
        repaired_m=np.where(mask[:, None], recording.repaired_m, np.nan),
    )


def hearing_only(recording: Recording, columns: Sequence[int]) -> Recording:
    """Return a recording with nothing heard but access points of these columns of A."""
    return recording.hearing(np.isin(np.arange(recording.heard.shape[1]), columns))


def _target(request: EvaluationRequest, data_root: Path) -> PackedSite:
    request.check()
    return read_packed(data_root, request.site)


def _laps(target: PackedSite, request: EvaluationRequest) -> list[PairedLap]:
    laps = paired_laps(target.recordings(), target.device_links)
    if not laps:
        raise FplocError(
            f"--site with --protocol {request.protocol}",
            value=request.site,
            expected="a site with a lap of both devices and a log of the link between them",
            way_out="choose another site, or `--protocol zero-shot`",
        )
    return [lap.thinned(request.thin) for lap in laps]


def _run(ready: Ready, request: EvaluationRequest, site: Site) -> _Run:
    method = ready.method
    return _Run(
        method=method.for_speed(request.speed_prior) if isinstance(method, Filtering) else method,
        site=site,
        offsets=ready.offsets,
        filter_settings=KalmanSettings.for_speed(request.speed_prior),
        settings=DeviceLinkSettings.read(),
    )


def _pairs(lap: PairedLap, alone: tuple[Track, Track]) -> tuple[Beside, Beside]:
    """Return both devices of a lap with the other beside each, their tracks put on the lap's clocks."""
    first, second = (
        replace(track, recording=replace(track.recording, t_s=recording.t_s))
        for track, recording in zip(alone, lap.devices, strict=True)
    )
    return Beside(first, second, lap.link), Beside(second, first, lap.link)


def _lap_tracks(run: _Run, laps: Sequence[PairedLap]) -> list[LapTracks]:
    alone = run.alone([device for lap in laps for device in lap.devices])
    both = list(zip(alone[0::2], alone[1::2], strict=True))
    pairs = [_pairs(lap, tracks) for lap, tracks in zip(laps, both, strict=True)]
    linked = run.joint([pair for of_lap in pairs for pair in of_lap])
    prior_m = run.offsets.offset_m
    found = []
    for index, (lap, of_lap) in enumerate(zip(laps, pairs, strict=True)):
        first, second = (company(pair, prior_m=prior_m, settings=run.settings).is_linked for pair in of_lap)
        found.append(
            LapTracks(
                lap=lap,
                alone=both[index],
                linked=(linked[2 * index], linked[2 * index + 1]),
                is_linked=(first, second),
            )
        )
    return found


def _both(laps: Sequence[LapTracks], kind: str) -> list[Track]:
    """Return the tracks of all laps, ``alone`` or ``linked``, device 1 and device 2 in turn."""
    return [track for lap in laps for track in getattr(lap, kind)]


def _linked_masks(laps: Sequence[LapTracks]) -> list[Bools]:
    """Return which intervals are linked, in the order of ``_both``."""
    return [mask for lap in laps for mask in lap.is_linked]


def _shifted(lap: LapTracks, shift: Mapping[str, float]) -> PairedLap:
    return lap.lap.shifted(**shift)


def _ranged_records(run: _Run, laps: Sequence[LapTracks], scored: _Scored) -> list[Record]:
    """Return the filtered records with ranges in the filter, without the link and with it."""
    masks = _linked_masks(laps)
    alone = run.ranged([replace(pair, link=NO_LINK) for lap in laps for pair in _pairs(lap.lap, lap.alone)])
    both = zip(laps, alone[0::2], alone[1::2], strict=True)
    linked = run.ranged([pair for lap, first, second in both for pair in _pairs(lap.lap, (first, second))])
    records = scored.records(alone, RANGES_IN_FILTER, masks) + scored.records(linked, LINK_IN_FILTER, masks)
    return [one for one in records if one.filter == KALMAN]


def _two_access_points(run: _Run, laps: Sequence[LapTracks], scored: _Scored) -> list[Record]:
    """Return mean, best and worst records of device 2 over all pairs of access points that it hears.

    Alone it has no fix then, so that the link's offset stays at its prior.
    """
    heard = np.any([lap.lap.devices[1].heard.any(axis=0) for lap in laps], axis=0)
    choices = list(combinations(np.flatnonzero(heard).tolist(), 2))
    few = [hearing_only(lap.lap.devices[1], columns) for columns in choices for lap in laps]
    alone = run.alone(few)
    again = [lap for _ in choices for lap in laps]
    pairs = [Beside(track, lap.alone[0], lap.lap.link) for track, lap in zip(alone, again, strict=True)]
    tracks = run.joint(pairs)
    masks = [lap.is_linked[1] for lap in laps]
    groups = [tracks[start : start + len(laps)] for start in range(0, len(tracks), len(laps))]
    records = [record for group in groups for record in scored.records(group, TWO_MEAN, masks)]
    kinds = dict.fromkeys((one.labels, one.filter) for one in records)
    return [
        summary
        for kind in kinds
        for summary in summaries([one for one in records if (one.labels, one.filter) == kind])
    ]


def summaries(records: Sequence[Record]) -> list[Record]:
    """Return the mean, the best and the worst of records that differ in the access points heard.

    Best and worst are by ``rmse_m``; records without any fix have none and stand aside. The mean's counts
    are means too, rounded.

    Args:
        records: At least one.
    """
    fixed = [one for one in records if one.rmse_m is not None]
    if not fixed:
        return [replace(records[0], condition=condition) for condition in (TWO_MEAN, TWO_BEST, TWO_WORST)]
    changes: dict[str, Any] = {name: _mean([getattr(one, name) for one in fixed]) for name in METRICS}
    for name in COUNTS:
        changes[name] = round(float(np.mean([getattr(one, name) for one in fixed])))
    in_order = sorted(fixed, key=lambda one: one.rmse_m if one.rmse_m is not None else np.inf)
    return [
        replace(fixed[0], condition=TWO_MEAN, **changes),
        replace(in_order[0], condition=TWO_BEST),
        replace(in_order[-1], condition=TWO_WORST),
    ]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
