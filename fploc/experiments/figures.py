"""Which figures belong to a preset, made from what its stages have left, and written to one folder.

A name begins with the kind of figure and goes on with protocol and site:

- ``cdf`` all methods, ``cdf-stages`` the four stages of the chain, ``bars`` RMSE of a protocol;
- ``stages`` the chain's trajectories, ``crop`` and ``attention`` of one link;
- ``access-points`` RMSE of all methods over their number, of each device;
- ``split`` what is learned from and what is tested on, ``devices`` the paths of two devices.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import torch
from matplotlib.figure import Figure

from fploc.datasets.packed import PackedSite
from fploc.datasets.recordings import Recording
from fploc.evaluation.chain_stages import STAGES, ChainTrack
from fploc.evaluation.conditions import ACCESS_POINTS, AS_IS, varied
from fploc.evaluation.error_series import ErrorSeries, pooled_errors_m
from fploc.evaluation.metrics import Floats
from fploc.evaluation.paper_numbers import published
from fploc.evaluation.protocols import EvaluationProtocol, Tested
from fploc.evaluation.records import NO_FILTER, TrackedRecord
from fploc.evaluation.selection import filtered_once
from fploc.files import whole
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.plots.access_points import plot_access_points
from fploc.plots.attention import plot_attention
from fploc.plots.bars import RmseRow, plot_rmse_bars
from fploc.plots.crop_preparation import plot_crop_preparation
from fploc.plots.results import plot_cdf
from fploc.plots.site_overlay import plot_site_overlay
from fploc.plots.split import plot_split
from fploc.plots.trajectories import plot_trajectories

DOTS_PER_INCH = 120
LABELS = "repaired"
SHOWN_LENGTH_M = 12.0
"""Crop and attention are shown of the link that is nearest to this length."""

Named = Iterator[tuple[str, Figure]]


@dataclass(frozen=True, eq=False)
class Place:
    """A target under a protocol, with what its figures are made from.

    Args:
        protocol: The protocol.
        source: Site that is learned from.
        target: Site that is tested on.
        errors: Of every interval, by method, of one seed.
        chain: ``gnn-fpdnn`` ready to run there; None where it was not run.
        tracks: What each of its stages made of recordings; empty where it was not run.
    """

    protocol: EvaluationProtocol
    source: PackedSite
    target: PackedSite
    errors: Mapping[str, Sequence[ErrorSeries]]
    chain: GNNFPDNN | None = None
    tracks: Sequence[ChainTrack] = ()

    @property
    def name(self) -> str:
        """Protocol and site, as they stand in file names."""
        return f"{self.protocol.name}--{self.target.site.name}"

    @property
    def title(self) -> str:
        """Protocol and site, as they stand above figures."""
        return f"{self.protocol.name}, {self.target.site.name}"

    @property
    def made_up(self) -> bool:
        """Whether the building is made up."""
        return self.target.site.made_up


def write_figures(
    places: Sequence[Place],
    records: Sequence[TrackedRecord],
    studied: Sequence[TrackedRecord],
    folder: Path,
) -> list[Path]:
    """Write all figures of a preset as PNG, each in one move, and return their files.

    Args:
        places: Everything that was scored.
        records: Plain records, for the bars (``fploc.evaluation.report.headline_records``).
        studied: Records of studies (``fploc.evaluation.conditions``).
        folder: Where they go.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, figure in (*_all_figures(places, records), *access_point_figures(studied)):
        file = folder / f"{name}.png"
        with whole(file) as part:
            figure.savefig(part, format="png", dpi=DOTS_PER_INCH)
        files.append(file)
    return files


def rmse_rows(records: Sequence[TrackedRecord], protocol: str, *, filtered: bool) -> list[RmseRow]:
    """Return the bars of a protocol, repaired labels, the paper's numbers with them.

    Args:
        records: Plain records.
        protocol: Name of the protocol.
        filtered: True for the results of filters, a method's own included; False for unfiltered ones.
    """
    shown = filtered_once(records) if filtered else [one for one in records if one.record.filter == NO_FILTER]
    return [
        RmseRow(
            place=f"{one.site}\ndevice {one.device}",
            method=one.method,
            rmse_m=one.rmse_m,
            paper_m=tuple(
                float(number.value)
                for number in published(
                    protocol, one.method, one.site, one.device, filtered=filtered, metric="rmse_m"
                )
            ),
        )
        for one in (tracked.record for tracked in shown)
        if (one.protocol, one.labels) == (protocol, LABELS)
    ]


def access_point_figures(studied: Sequence[TrackedRecord]) -> Named:
    """Yield the RMSE of every method over the number of access points, filtered, of each device of each site."""
    groups: dict[tuple[str, int, bool], dict[str, dict[int, float]]] = {}
    for tracked in filtered_once(studied):
        one = tracked.record
        study, value = varied(one.condition)
        shown = one.labels == LABELS and one.rmse_m is not None
        if study == ACCESS_POINTS and value != AS_IS and shown:
            methods = groups.setdefault((one.site, one.device, tracked.made_up), {})
            methods.setdefault(one.method, {}).setdefault(int(value), cast(float, one.rmse_m))
    for (site, device, made_up), rmse_m in groups.items():
        figure = plot_access_points(
            rmse_m, f"zero-shot, {site}, device {device}, {LABELS} labels", made_up=made_up
        )
        yield f"access-points--{site}--device{device}", figure


def cdf_figures(place: Place) -> Named:
    """Yield the distribution of errors of all methods and of the chain's stages, for each device."""
    for device in sorted({one.device for series in place.errors.values() for one in series}):
        errors = {
            method: pooled_errors_m(series, device, filtered=True) for method, series in place.errors.items()
        }
        title = f"{place.title}, device {device}"
        yield (
            f"cdf--{place.name}--device{device}",
            plot_cdf(errors, f"{title}, with filter", made_up=place.made_up),
        )
        stages = _stage_errors(place, device)
        if stages:
            yield (
                f"cdf-stages--{place.name}--device{device}",
                plot_cdf(stages, f"{title}, stages", made_up=place.made_up),
            )


def chain_figures(place: Place) -> Named:
    """Yield the trajectories of the chain for each device, and one link as the chain sees it."""
    for track in _first_of_each_device(place.tracks):
        one = track.recording
        yield (
            f"stages--{place.name}--device{one.device}",
            plot_trajectories(
                place.target.plan,
                place.target.site,
                one.labels_m(LABELS),
                {stage: track.paths[stage].positions_m for stage in STAGES},
                title=f"{place.title}, device {one.device}, lap {one.name}",
            ),
        )
    link = _shown_link(place.tracks[0], place.target) if place.tracks else None
    if place.chain is None or link is None:
        return
    access_point, coarse_m = link
    name = place.target.site.access_points[access_point].name
    title = f"{place.title}: {name} to a coarse position"
    yield (
        f"crop--{place.name}",
        plot_crop_preparation(
            place.target.plan, place.target.site, access_point, coarse_m, place.chain.crops, title=title
        ),
    )
    yield f"attention--{place.name}", _attention_figure(place, place.chain, access_point, coarse_m, title)


def split_figure(place: Place) -> Figure | None:
    """Return what is learned from and what is tested on; None where no recording of the target is learned from."""
    target = place.target
    recordings = [one for one in target.recordings() if np.isfinite(one.labels_m(LABELS)).any()]
    if place.protocol.tested is Tested.TEST_RECORDINGS:
        parts = {
            f"{use}: {', '.join(name for _, name in target.splits.part(part))}": [
                one.labels_m(LABELS)
                for one in recordings
                if (one.device, one.name) in target.splits.part(part)
            ]
            for use, part in (("trains", "train"), ("validates", "validate"), ("tests", "test"))
        }
    elif place.protocol.tested is Tested.SECOND_PART:
        pairs = list(zip(recordings, place.protocol.parts(recordings, target.site), strict=True))
        parts = {
            "fine-tunes": [_only(one, first) for one, (first, _) in pairs],
            "tests": [_only(one, second) for one, (_, second) in pairs],
            "left out": [_only(one, ~(first | second)) for one, (first, second) in pairs],
        }
    else:
        return None
    return plot_split(target.plan, target.site, parts, title=f"parts of {place.title}, {LABELS} labels")


def device_figure(packed: PackedSite) -> Figure | None:
    """Return the paths of the first recording of each device; None where there is only one device."""
    first = {one.device: one for one in reversed(packed.recordings())}
    if len(first) < 2:
        return None
    paths = {
        f"device {device}, lap {first[device].name}": first[device].labels_m(LABELS)
        for device in sorted(first)
    }
    return plot_site_overlay(packed.plan, packed.site, paths)


def _all_figures(places: Sequence[Place], records: Sequence[TrackedRecord]) -> Named:
    for protocol in dict.fromkeys(place.protocol.name for place in places):
        made_up = any(place.made_up for place in places)
        for filtered, behind in ((False, "unfiltered"), (True, "with filter")):
            rows = rmse_rows(records, protocol, filtered=filtered)
            if rows:
                title = f"{protocol}, {behind}, {LABELS} labels"
                yield (
                    f"bars--{protocol}--{'kalman' if filtered else 'none'}",
                    plot_rmse_bars(rows, title, made_up=made_up),
                )
    for place in places:
        yield from cdf_figures(place)
        yield from chain_figures(place)
        split = split_figure(place)
        if split is not None:
            yield f"split--{place.name}", split
    for packed in {place.target.site.name: place.target for place in places}.values():
        devices = device_figure(packed)
        if devices is not None:
            yield f"devices--{packed.site.name}", devices


def _stage_errors(place: Place, device: int) -> dict[str, Floats]:
    """Return the errors of each of ``STAGES``; nothing where one of the two methods was not run."""
    methods = ("gnn", "gnn-fpdnn")
    if not all(method in place.errors for method in methods):
        return {}
    ends = [(method, filtered) for method in methods for filtered in (False, True)]
    return {
        stage: pooled_errors_m(place.errors[method], device, filtered=filtered)
        for stage, (method, filtered) in zip(STAGES, ends, strict=True)
    }


def _first_of_each_device(tracks: Sequence[ChainTrack]) -> list[ChainTrack]:
    first = {track.recording.device: track for track in reversed(tracks)}
    return [first[device] for device in sorted(first)]


def _shown_link(track: ChainTrack, packed: PackedSite) -> tuple[int, Floats] | None:
    """Return access point and coarse position of the link nearest to 12 m, half-way through a recording."""
    coarse = track.paths["GNN + KF"]
    usable = np.flatnonzero(coarse.fixed & np.isfinite(track.corrected_m).any(axis=1))
    if not usable.size:
        return None
    at = usable[len(usable) // 2]
    lengths = np.linalg.norm(packed.site.positions_m - coarse.positions_m[at], axis=1)
    misses = np.where(np.isfinite(track.corrected_m[at]), np.abs(lengths - SHOWN_LENGTH_M), np.inf)
    return int(misses.argmin()), coarse.positions_m[at]


def _attention_figure(
    place: Place, chain: GNNFPDNN, access_point: int, coarse_m: Floats, title: str
) -> Figure:
    start = torch.tensor(place.target.site.positions_m[[access_point]], dtype=torch.float32)
    crops = chain.crops.crop_softened(chain.plan, start, torch.tensor(coarse_m[None], dtype=torch.float32))
    vision = chain.network.vision
    with torch.inference_mode():
        attention = vision.attention(crops.images, crops.lengths_px)
    return plot_attention(
        crops.images[0, 0, :, : int(crops.lengths_px[0])].double().numpy(),
        {
            "the class token attends to": attention.class_token[0].double().numpy(),
            "the patches attend to, on average": attention.patches[0].double().numpy(),
        },
        patch_px=vision.patch_px,
        pixels_per_metre=chain.crops.pixels_per_metre,
        title=title,
        made_up=place.made_up,
    )


def _only(recording: Recording, mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Floats:
    """Return the labels of the intervals of a mask, shape (T, 2); NaN elsewhere."""
    return np.where(mask[:, None], recording.labels_m(LABELS), np.nan)
