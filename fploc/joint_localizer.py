"""Two devices at once: each is located with the other, and the range between them, beside it.

Both are located alone first. At each interval of a device the other's latest interval, its latest filtered fix and
the latest reading of the link stand beside it, none older than a stated age; the link's offset is a state that
is learned from the fixes so far (``fploc.calibration.link_offset``). What a method makes of them:

- the GNN gets edges between the two devices both ways, and needs three neighbours, the other device included;
- before FPDNN the link enters the filter on coarse positions, and behind it the solver takes the other device as
  one more access point;
- a solver of single intervals is chained: device 1 alone, device 2 with device 1 as one more access point.

That the link enters the filter on coarse positions, and that the solver starts near these, was chosen with the
mall's labels in view: of the mall, results of two devices are those of a development site.

``ranged_tracks`` is another way to use the link, the same for every method: it enters the Kalman filter as a range,
and so do ranges to access points where they are too few for a fix.

Axes: B devices (each an entry of the batch), T intervals, A access points, R readings of a link.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.calibration.link_offset import LinkOffsets, LinkOffsetSettings, running_link_offsets
from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import recorded_intervals
from fploc.conf import instantiate, read_conf
from fploc.datasets.paired import LinkReadings, latest_before
from fploc.datasets.recordings import Bools, Floats, Recording
from fploc.filters.kalman import BatchedFilter, KalmanSettings
from fploc.filters.range_update import RangedFilter, Ranges
from fploc.intervals import DeviceLinks, Estimate, Intervals, NoFix, stacked
from fploc.localizer import (
    ROWS_AT_ONCE,
    Path,
    Track,
    chunks,
    flat,
    joined,
    path_of,
)
from fploc.methods.chained import Companion, chained
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.methods.interface import Method
from fploc.methods.one_shot import OneShotMethod
from fploc.models.fpdnn import RSS_CENTRE_DBM
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site
from fploc.solvers.losses import Loss

NAME = "device-link"
LEADING_DEVICE = 1
"""Solved alone where a method is chained."""


@dataclass(frozen=True)
class DeviceLinkSettings:
    """Settings of what stands beside a device: conf/link/device-link.yaml.

    Args:
        oldest_s: Age up to which another device's interval or a reading of the link counts, seconds.
        range_sd_m: Standard deviation of a range to an access point, metres.
        loss: Of ranges behind FPDNN where fewer than three access points are heard.
        offset: Of the link's offset.
    """

    oldest_s: float
    range_sd_m: float
    loss: Loss
    offset: LinkOffsetSettings

    @classmethod
    def read(cls) -> DeviceLinkSettings:
        """Return the settings in conf/link/device-link.yaml."""
        return instantiate(cls, read_conf("link", NAME), source=f"conf/link/{NAME}.yaml")


@dataclass(frozen=True)
class Beside:
    """One device of a lap with the other beside it.

    Args:
        own: Track of the device alone.
        other: Track of the other device alone, on the same clock.
        link: What was measured between them, on the same clock.
    """

    own: Track
    other: Track
    link: LinkReadings


@dataclass(frozen=True)
class Company:
    """What stands beside each interval of one device, never of the future.

    Args:
        other: Index of the other device's interval, shape (T,); 0 where there is none.
        is_linked: True where it and a reading of the link are young enough, shape (T,).
        ranges_m: Of the link without its offset, shape (T,), metres.
        variances_m2: Of these, shape (T,), square metres.
        rss_dbm: Of the link, shape (T,), dBm.
        positions_m: Latest filtered fix of the other device, shape (T, 2), metres, site frame; 0 where none.
        covariances_m2: Of these, shape (T, 2, 2), square metres; 0 where none.
        is_placed: True where it is young enough and linked, shape (T,).
    """

    other: NDArray[np.int64]
    is_linked: Bools
    ranges_m: Floats
    variances_m2: Floats
    rss_dbm: Floats
    positions_m: Floats
    covariances_m2: Floats
    is_placed: Bools


def filtered_path(track: Track) -> Path:
    """Return the filtered path of a track, or its own where no filter was asked for."""
    return track.unfiltered if track.filtered is None else track.filtered


def link_offsets(beside: Beside, *, prior_m: float, settings: DeviceLinkSettings) -> LinkOffsets:
    """Return the offset of a link as each of its readings leaves it known; only the tracks alone enter.

    Args:
        beside: Of either device.
        prior_m: Offset of ranges to access points, metres.
        settings: Of the link.
    """
    link, tracks = beside.link, (beside.own, beside.other)
    found = [latest_before(track.t_s, link.t_s, settings.oldest_s) for track in tracks]
    at = [index for index, _ in found]
    fixed = [
        is_fresh & track.unfiltered.fixed[index]
        for track, (index, is_fresh) in zip(tracks, found, strict=True)
    ]
    first, second = (filtered_path(track) for track in tracks)
    return running_link_offsets(
        link.t_s,
        link.ranges_m,
        (first.positions_m[at[0]], second.positions_m[at[1]]),
        (first.covariances_m2[at[0]], second.covariances_m2[at[1]]),
        fixed[0] & fixed[1],
        prior_m=prior_m,
        settings=settings.offset,
    )


def company(beside: Beside, *, prior_m: float, settings: DeviceLinkSettings) -> Company:
    """Return what stands beside each interval of a device; arguments as ``link_offsets``."""
    times = beside.own.t_s
    offsets = link_offsets(beside, prior_m=prior_m, settings=settings)
    reading, has_reading = latest_before(beside.link.t_s, times, settings.oldest_s)
    other, has_other = latest_before(beside.other.t_s, times, settings.oldest_s)
    is_linked = has_reading & has_other
    ranges_m = np.maximum(beside.link.ranges_m[reading] - offsets.means_m[reading + 1], 0.0)
    path = filtered_path(beside.other)
    fixes = np.flatnonzero(path.fixed)
    latest, is_young = latest_before(beside.other.t_s[fixes], times, settings.oldest_s)
    is_placed = is_linked & is_young
    fix = fixes[latest] if fixes.size else latest
    return Company(
        other=other,
        is_linked=is_linked,
        ranges_m=np.where(is_linked, ranges_m, 0.0),
        variances_m2=settings.offset.spread_m**2 + offsets.sds_m[reading + 1] ** 2,
        rss_dbm=np.nan_to_num(beside.link.rss_dbm[reading], nan=RSS_CENTRE_DBM),
        positions_m=np.where(is_placed[:, None], path.positions_m[fix], 0.0),
        covariances_m2=np.where(is_placed[:, None, None], path.covariances_m2[fix], 0.0),
        is_placed=is_placed,
    )


def is_joint(method: Method) -> bool:
    """Return whether ``joint_tracks`` knows how to give a method another device."""
    return isinstance(method, (GNNMethod, GNNFPDNN, OneShotMethod))


def joint_tracks(
    method: Method,
    site: Site,
    pairs: Sequence[Beside],
    offsets: RangeOffsets,
    filter_settings: KalmanSettings,
    settings: DeviceLinkSettings,
) -> list[Track]:
    """Run a method over devices with the other beside each.

    Args:
        method: One that ``is_joint``.
        site: Where the recordings were made.
        pairs: At least one device and the other.
        offsets: Range offsets to access points.
        filter_settings: Of the Kalman filter on the method's fixes.
        settings: Of the link.

    Returns:
        The track of each pair's own device, in their order.
    """
    assert is_joint(method), f"{method.name} takes no other device"
    batch = _Batch.of(site, pairs, offsets, settings)
    tracker = BatchedFilter(filter_settings)
    with torch.inference_mode():
        started = time.perf_counter()
        match method:
            case GNNMethod():
                found = _gnn(method, site, batch)
            case GNNFPDNN():
                found = _gnn_fpdnn(method, site, batch, settings)
            case OneShotMethod():
                found = _chained(method, site, batch, [pair.own.recording for pair in pairs], settings)
        located = time.perf_counter()
        filtered = tracker.run(batch.own.t_s, batch.own.present, found)
        ended = time.perf_counter()
    count = int(batch.own.present.sum()) / 1000.0
    return [
        Track(
            pair.own.recording,
            path_of(found, index, len(pair.own.recording), ms_per_fix=(located - started) / count),
            path_of(filtered, index, len(pair.own.recording), ms_per_fix=(ended - started) / count),
            own_filter=False,
        )
        for index, pair in enumerate(pairs)
    ]


def ranged_tracks(
    site: Site,
    pairs: Sequence[Beside],
    offsets: RangeOffsets,
    filter_settings: KalmanSettings,
    settings: DeviceLinkSettings,
) -> list[Track]:
    """Filter the fixes that devices have alone anew, with ranges in the filter.

    The link enters as a range to where the other device is; at intervals without a fix the ranges to access
    points enter too, as they are without their offset. Pairs with ``NO_LINK`` show what the latter are worth.

    Args:
        site: Where the recordings were made.
        pairs: At least one device and the other.
        offsets: Range offsets to access points.
        filter_settings: Of the Kalman filter.
        settings: Of the link.

    Returns:
        The track of each pair's own device, in their order; their unfiltered paths are those given.
    """
    with torch.inference_mode():
        batch = _Batch.of(site, pairs, offsets, settings)
        started = time.perf_counter()
        fixes = _fixes(pairs, batch.shape[0])
        together = _ranged(site, batch, fixes, ~fixes.fixed, filter_settings, settings)
        spent_ms = 1000.0 * (time.perf_counter() - started) / int(batch.own.present.sum())
    return [
        replace(
            pair.own,
            filtered=path_of(
                together, index, len(pair.own.t_s), ms_per_fix=pair.own.unfiltered.ms_per_fix + spent_ms
            ),
        )
        for index, pair in enumerate(pairs)
    ]


@dataclass(frozen=True)
class _Batch:
    """Devices side by side, time first, with what stands beside each interval.

    Args:
        own: Intervals of the devices, shape (T, B, …).
        other: The other device's interval beside each, shape (T, B, …); present where linked.
        companion: The other device as an anchor, shape (T · B, …).
        rss: Of the link, shape (T, B), dBm.
    """

    own: Intervals
    other: Intervals
    companion: Companion
    rss: Tensor

    @classmethod
    def of(
        cls, site: Site, pairs: Sequence[Beside], offsets: RangeOffsets, settings: DeviceLinkSettings
    ) -> _Batch:
        """Return the batch of some devices."""
        own, others = (
            recorded_intervals(recordings, site, offsets)
            for recordings in (
                [pair.own.recording for pair in pairs],
                [pair.other.recording for pair in pairs],
            )
        )
        beside = [company(pair, prior_m=offsets.offset_m, settings=settings) for pair in pairs]
        steps = len(own.t_s)

        def padded(name: str) -> Tensor:
            return _side_by_side([getattr(one, name) for one in beside], steps)

        index = (padded("other"), torch.arange(len(pairs)))
        linked = padded("is_linked")
        return cls(
            own=own,
            other=Intervals(
                t_s=others.t_s[index],
                ranges=others.ranges[index],
                stds=others.stds[index],
                rss=others.rss[index],
                heard=others.heard[index] & linked[..., None],
                present=linked,
            ),
            companion=Companion(
                positions=padded("positions_m").flatten(0, 1),
                covariances=padded("covariances_m2").flatten(0, 1),
                ranges=padded("ranges_m").flatten(),
                variances=padded("variances_m2").flatten(),
                there=padded("is_placed").flatten(),
            ),
            rss=padded("rss_dbm"),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """T and B."""
        steps, devices = self.own.t_s.shape
        return steps, devices

    def companion_at(self, step: int) -> Companion:
        """Return the companion of every device at one step."""
        devices = self.shape[1]
        return self.companion.at(slice(step * devices, (step + 1) * devices))


def _side_by_side(arrays: Sequence[NDArray[np.generic]], steps: int) -> Tensor:
    """Return arrays (T, …) of several devices as one of shape (``steps``, B, …), padded at their ends."""
    padded = [np.pad(array, [(0, steps - len(array))] + [(0, 0)] * (array.ndim - 1)) for array in arrays]
    return torch.from_numpy(np.stack(padded, axis=1))


def _fixes(pairs: Sequence[Beside], steps: int) -> Estimate:
    """Return the fixes that the devices have alone, shape (T, B, …)."""
    paths = [pair.own.unfiltered for pair in pairs]
    there = _side_by_side([path.fixed for path in paths], steps)
    reasons = _side_by_side([path.reasons for path in paths], steps)
    return Estimate(
        positions=_side_by_side([path.positions_m for path in paths], steps),
        covariances=_side_by_side([path.covariances_m2 for path in paths], steps),
        reasons=torch.where(there | (reasons != NoFix.FIXED), reasons, int(NoFix.NO_READING)),
    )


def _ranged(
    site: Site,
    batch: _Batch,
    fixes: Estimate,
    is_free: Tensor,
    filter_settings: KalmanSettings,
    settings: DeviceLinkSettings,
) -> Estimate:
    """Return fixes filtered with the link and, where ``is_free`` (T, B), ranges to access points; (T, B, …)."""
    tracker = RangedFilter(filter_settings, settings.offset.correlation_s)
    own, access_points = batch.own.nearer_than(FARTHEST_RANGE_M), torch.from_numpy(site.positions_m)
    steps, devices = batch.shape
    state, filtered = tracker.init(devices), []
    for step in range(steps):
        shown = Estimate(fixes.positions[step], fixes.covariances[step], fixes.reasons[step])
        further = _further_ranges(
            own.at(step), batch.companion_at(step), access_points, is_free[step], settings
        )
        state, one = tracker.step(state, own.t_s[step], own.present[step], shown, further)
        filtered.append(one)
    return stacked(filtered)


def _further_ranges(
    intervals: Intervals,
    companion: Companion,
    access_points: Tensor,
    is_free: Tensor,
    settings: DeviceLinkSettings,
) -> Ranges:
    """Return what enters the filter beside fixes: the link, and where ``is_free`` (B,) access points."""
    anchors = companion.anchors(access_points)
    of_places = torch.zeros(*anchors.shape, 2, dtype=anchors.dtype)
    of_places[:, -1] = companion.covariances
    ranges = intervals.ranges.double()
    return Ranges(
        anchors=anchors,
        ranges=companion.behind(ranges, companion.ranges),
        variances=companion.behind(torch.full_like(ranges, settings.range_sd_m**2), companion.variances),
        anchor_covariances=of_places,
        there=companion.behind(intervals.heard & is_free[:, None], companion.there),
    )


def _gnn(method: GNNMethod, site: Site, batch: _Batch) -> Estimate:
    """Return the GNN's fixes with an edge to the other device, shape (T, B, …)."""
    steps, devices = batch.shape
    own, other = flat(batch.own), flat(batch.other)
    state = method.init(site, steps * devices)
    found = []
    for at in chunks(steps * devices, ROWS_AT_ONCE):
        mine, theirs = own.at(at), other.at(at)
        number = len(mine.t_s)
        (row,) = torch.nonzero(mine.present & theirs.present, as_tuple=True)
        there = torch.stack([row, row + number])
        links = DeviceLinks(
            index=torch.cat([there, there.flip(0)], dim=1),
            ranges=batch.companion.ranges[at][row].repeat(2),
            rss=batch.rss.flatten()[at][row].repeat(2),
        )
        _, both = method.step(state, _one_after_the_other(mine, theirs, links))
        found.append(Estimate(both.positions[:number], both.covariances[:number], both.reasons[:number]))
    return joined(found, steps, devices)


def _gnn_alone(method: Method, site: Site, batch: _Batch) -> Estimate:
    """Return the GNN's fixes of each device alone, shape (T, B, …)."""
    steps, devices = batch.shape
    rows, state = flat(batch.own), method.init(site, steps * devices)
    found = [method.step(state, rows.at(at))[1] for at in chunks(steps * devices, ROWS_AT_ONCE)]
    return joined(found, steps, devices)


def _one_after_the_other(mine: Intervals, theirs: Intervals, links: DeviceLinks) -> Intervals:
    """Return intervals (B, …) and those of the other devices as one batch (2 B, …) with their links."""
    names = [one.name for one in fields(Intervals) if one.name != "links"]
    arrays = {name: torch.cat([getattr(mine, name), getattr(theirs, name)]) for name in names}
    return Intervals(**arrays, links=links)


def _gnn_fpdnn(method: GNNFPDNN, site: Site, batch: _Batch, settings: DeviceLinkSettings) -> Estimate:
    """Return the chain's fixes with the other device beside each, shape (T, B, …).

    The coarse positions are the GNN's of each device alone; the link enters the filter that smooths them, and
    with it the ranges to access points that are too few for the GNN, so that there are crops for these too.
    """
    steps, devices = batch.shape
    alone = _gnn_alone(method.coarse, site, batch)
    is_free = ~alone.fixed & batch.companion.there.reshape(steps, devices)
    coarse = _ranged(site, batch, alone, is_free, method.filter.settings, settings)
    rows, access_points = flat(batch.own), method.coarse.init(site, devices)
    refined = []
    for at in chunks(steps * devices, method.rows_at_once(len(site.access_points))):
        filtered = Estimate(
            coarse.positions.flatten(0, 1)[at],
            coarse.covariances.flatten(0, 1)[at],
            coarse.reasons.flatten()[at],
        )
        refined.append(
            method.refine_beside(
                access_points, rows.at(at), filtered, batch.companion.at(at), loss=settings.loss
            )
        )
    return joined(refined, steps, devices)


def _chained(
    method: OneShotMethod,
    site: Site,
    batch: _Batch,
    recordings: Sequence[Recording],
    settings: DeviceLinkSettings,
) -> Estimate:
    """Return a solver's fixes, all devices but the leading one chained through the other; shape (T, B, …)."""
    steps, devices = batch.shape
    follows = torch.tensor([one.device != LEADING_DEVICE for one in recordings]).repeat(steps)
    companion = replace(batch.companion, there=batch.companion.there & follows)
    rows, state = flat(batch.own), method.init(site, devices)
    found = [
        chained(method, state, rows.at(at), companion.at(at), range_sd_m=settings.range_sd_m)
        for at in chunks(steps * devices, ROWS_AT_ONCE)
    ]
    return joined(found, steps, devices)
