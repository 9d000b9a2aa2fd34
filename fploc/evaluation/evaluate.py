"""Evaluating one method at one site under one protocol: tracks first, then records of them.

A method comes ready made: geometric ones from ``fploc.methods.registry``, learned ones out of their artifact.
Nothing is trained here but range offsets, and those on the protocol's source alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from fploc.calibration.offsets import (
    RangeOffsets,
    SourceRecordings,
    constant_offset,
    fit_pooled_offsets,
)
from fploc.datasets.packed import (
    manifest_hash,
    packed_folder,
    packed_sites,
    read_manifest,
    read_packed,
)
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError, UnknownNameError
from fploc.evaluation.metrics import Scores, score
from fploc.evaluation.protocols import PUBLIC_SOURCE, protocol_of, validation_site
from fploc.evaluation.records import KALMAN, NO_FILTER, OWN, Record, finite_or_none
from fploc.evaluation.revision import running_commit
from fploc.filters.kalman import HEADLINE_SPEED_MPS, KalmanSettings
from fploc.localizer import Path as DevicePath
from fploc.localizer import Track, localize, localize_offline
from fploc.methods.interface import Filtering, Method

PUBLISHED, REPAIRED, BOTH = "published", "repaired", "both"
LABELS = (PUBLISHED, REPAIRED, BOTH)


@dataclass(frozen=True)
class EvaluationRequest:
    """What is asked of an evaluation; the options of `fploc evaluate`.

    Args:
        protocol: Name of the protocol.
        site: Target.
        device: ``1``, ``2`` or ``all``.
        calibration: How range offsets are fitted on the source, or a number of metres.
        labels: ``published``, ``repaired`` or ``both``.
        plan: Which plan the method was made with: it is recorded here and acts in the method.
        speed_prior: Of the filter, and of a method that is one itself, metres per second.
        thin: Keep every ``thin``-th interval with the original time step.
        smoother: Offline: every position is smoothed by what came after it.
        preset: That the method was trained with.
        seed: Of the method's training.
        source: Site that the protocol learns from.
    """

    protocol: str
    site: str
    device: str = "all"
    calibration: str = "source-los"
    labels: str = BOTH
    plan: str = "real"
    speed_prior: float = HEADLINE_SPEED_MPS
    thin: int = 1
    preset: str = "default"
    seed: int = 0
    source: str = PUBLIC_SOURCE
    smoother: bool = False

    def check(self) -> None:
        """Raise where an option cannot be used.

        Raises:
            FplocError: Naming the option.
        """
        protocol_of(self.protocol, self.source).check_target(self.site)
        constant_offset(self.calibration)
        if self.labels not in LABELS:
            raise UnknownNameError("--labels", self.labels, known=list(LABELS), way_out="choose one of these")
        if not (math.isfinite(self.speed_prior) and self.speed_prior > 0):
            raise FplocError(
                "--speed-prior",
                value=self.speed_prior,
                expected="a number of metres per second above 0",
                way_out="write for example `--speed-prior 0.5`",
            )
        if self.thin < 1:
            raise FplocError(
                "--thin", value=self.thin, expected="1 or more", way_out="write 1 to keep every interval"
            )


def source_offsets(request: EvaluationRequest, data_root: Path) -> RangeOffsets:
    """Return the range offsets of a request, fitted on what its protocol learns from."""
    constant = constant_offset(request.calibration)
    if constant is not None:
        return RangeOffsets(request.calibration, constant)
    there = [packed_folder(data_root, name) for name in packed_sites(data_root)]
    hashes = tuple(manifest_hash(read_manifest(folder)) for folder in there)
    learned = EvaluationRequest(request.protocol, request.site, source=request.source)
    return _fitted_offsets(request.calibration, learned, data_root, hashes)


@lru_cache(maxsize=32)
def _fitted_offsets(
    calibration: str, request: EvaluationRequest, data_root: Path, hashes: tuple[str, ...]
) -> RangeOffsets:
    """Fit offsets once for many methods at a target, as long as no packed site changes its hash."""
    return fit_pooled_offsets(calibration, source_recordings(request, data_root))


def source_recordings(request: EvaluationRequest, data_root: Path) -> list[SourceRecordings]:
    """Return the recordings that methods for the target of a request learn from, by site.

    Of several sites, one is left to validate on.
    """
    every = every_source_recording(request, data_root)
    if not protocol_of(request.protocol, request.source).pools:
        return every
    validating = validation_site([one.site.name for one in every])
    return [one for one in every if one.site.name != validating]


def every_source_recording(request: EvaluationRequest, data_root: Path) -> list[SourceRecordings]:
    """Return the recordings that a method for the target may learn from which validates on none, by site.

    Raises:
        FplocError: If there is none.
    """
    protocol = protocol_of(request.protocol, request.source)
    if not protocol.pools:
        source = read_packed(data_root, protocol.source)
        return [SourceRecordings(protocol.training(source), source.site, source.plan)]
    packed = [read_packed(data_root, name) for name in packed_sites(data_root)]
    target = next(one.site for one in packed if one.site.name == request.site)
    names = protocol.sources(target, [one.site for one in packed])
    by_name = {one.site.name: one for one in packed}
    chosen = [by_name[name] for name in names if name in by_name]
    if not chosen:
        raise FplocError(
            f"packed sites to learn from for {request.site}",
            value="none",
            expected=f"at least one of {', '.join(names)}",
            way_out="build more sites with `fploc data build`, or take `--method default`, which has learned before",
        )
    return [SourceRecordings(one.recordings(), one.site, one.plan) for one in chosen]


def tracks_of(
    method: Method, request: EvaluationRequest, data_root: Path, *, offsets: RangeOffsets | None = None
) -> list[Track]:
    """Run a method over the recordings that a request asks for, unfiltered and filtered in one pass.

    Args:
        method: Ready to run at the target.
        request: What is asked.
        data_root: Folder of packed sites.
        offsets: Range offsets; None fits them as the request says.

    Raises:
        FplocError: If an option cannot be used, or the data are not there.
    """
    request.check()
    target = read_packed(data_root, request.site)
    recordings = protocol_of(request.protocol, request.source).testing(target, request.device)
    removed = source_offsets(request, data_root) if offsets is None else offsets
    thinned = [one.thinned(request.thin) for one in recordings]
    settings = KalmanSettings.for_speed(request.speed_prior)
    run = localize_offline if request.smoother else localize
    return run(paced(method, request.speed_prior), target.site, thinned, removed, settings)


def paced(method: Method, speed_mps: float) -> Method:
    """Return a method that expects such a speed, metres per second, where it is a filter itself."""
    return method.for_speed(speed_mps) if isinstance(method, Filtering) else method


def records_of(
    method_name: str, request: EvaluationRequest, tracks: Sequence[Track], *, artifact: str | None = None
) -> list[Record]:
    """Score tracks: a record for each device, kind of labels and filter.

    Args:
        method_name: As it is to stand in the records.
        request: What the tracks were made for.
        tracks: Of one site.
        artifact: What the method was trained as; None for a method without training.

    Raises:
        FplocError: If the labels asked for do not exist there.
    """
    records = []
    for device in sorted({track.recording.device for track in tracks}):
        of_device = [track for track in tracks if track.recording.device == device]
        for labels in _labels_there(request, [track.recording for track in of_device]):
            for name, paths in _paths_by_filter(of_device, request).items():
                scores = score(paths, [track.recording.labels_m(labels) for track in of_device])
                records.append(
                    _record(method_name, request, device, labels, name, scores, paths[0].ms_per_fix, artifact)
                )
    return records


def evaluate(
    method: Method,
    request: EvaluationRequest,
    data_root: Path,
    *,
    offsets: RangeOffsets | None = None,
    artifact: str | None = None,
) -> list[Record]:
    """Run and score a method; arguments as for ``tracks_of`` and ``records_of``."""
    tracks = tracks_of(method, request, data_root, offsets=offsets)
    return records_of(method.name, request, tracks, artifact=artifact)


def _labels_there(request: EvaluationRequest, recordings: Sequence[Recording]) -> list[str]:
    """Return the kinds of labels to score with."""
    wanted = [PUBLISHED, REPAIRED] if request.labels == BOTH else [request.labels]
    there = [kind for kind in wanted if any(np.isfinite(one.labels_m(kind)).any() for one in recordings)]
    if not there:
        raise FplocError(
            f"--labels for {request.site}",
            value=request.labels,
            expected="a kind of ground truth that its recordings have",
            way_out="see `fploc data describe`, or choose `--labels both`",
        )
    return there


def _paths_by_filter(tracks: Sequence[Track], request: EvaluationRequest) -> dict[str, list[DevicePath]]:
    """Return the paths of every track by filter; offline, those that no smoother made are left out."""
    paths = {}
    if tracks[0].own_filter:
        paths[OWN] = [track.unfiltered for track in tracks]
    elif not request.smoother:
        paths[NO_FILTER] = [track.unfiltered for track in tracks]
    filtered = [track.filtered for track in tracks if track.filtered is not None]
    if filtered:
        paths[KALMAN] = filtered
    return paths


def _record(
    method_name: str,
    request: EvaluationRequest,
    device: int,
    labels: str,
    filter_name: str,
    scores: Scores,
    ms_per_fix: float,
    artifact: str | None,
) -> Record:
    return Record(
        method=method_name,
        protocol=request.protocol,
        site=request.site,
        device=device,
        labels=labels,
        calibration=request.calibration,
        plan=request.plan,
        speed_prior=request.speed_prior,
        smoother=request.smoother,
        thin=request.thin,
        filter=filter_name,
        preset=request.preset,
        seed=request.seed,
        n=scores.n,
        n_before_first_fix=scores.n_before_first_fix,
        no_fix_share=finite_or_none(scores.no_fix_share),
        rmse_m=finite_or_none(scores.rmse_m),
        rmse_fixed_m=finite_or_none(scores.rmse_fixed_m),
        mae_m=finite_or_none(scores.mae_m),
        p50_m=finite_or_none(scores.p50_m),
        p90_m=finite_or_none(scores.p90_m),
        p95_m=finite_or_none(scores.p95_m),
        coverage95=finite_or_none(scores.coverage95),
        nees=finite_or_none(scores.nees),
        ms_per_fix=ms_per_fix,
        artifact=artifact,
        commit=running_commit(),
    )
