"""``fploc model``: trains the default method, as it ships and without each place that it learned at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fploc.artifacts import Artifact, ArtifactKey, offsets_of
from fploc.calibration.offsets import SourceRecordings, fit_pooled_offsets
from fploc.datasets.packed import packed_sites, read_packed
from fploc.errors import MissingFileError, UnknownNameError
from fploc.evaluation.evaluate import (
    REPAIRED,
    EvaluationRequest,
    every_source_recording,
    records_of,
    tracks_of,
)
from fploc.evaluation.metrics import normalised_errors
from fploc.evaluation.protocols import POOLED_SITES, PUBLIC_SOURCE, protocol_of
from fploc.evaluation.records import OWN, Record, write_records
from fploc.experiments.model_card import model_card
from fploc.experiments.scoring import artifacts_folder, data_hash, learned_and_tested
from fploc.experiments.source_fit import fitted_on
from fploc.files import whole
from fploc.methods.learned_grid import LearnedGrid, LearnedGridFilter
from fploc.methods.stored_grid import restored, stored
from fploc.plots.reliability import plot_reliability
from fploc.progress import track
from fploc.shipped import (
    DEFAULT,
    MODEL,
    POOLED,
    SEED,
    SHIPPING_COMMAND,
    SOURCE_ONLY,
    leave_one_out_key,
    model_command,
)

RECORDS, CARD, RELIABILITY = "records.jsonl", "MODEL.md", "reliability.png"


def make_model(sites: Sequence[str] | None, data_root: Path, runs: Path, out: Path | None) -> list[Record]:
    """Train the default method and return its records at sites that it did not see.

    Args:
        sites: Sites to leave out one at a time; None for all packed ones that it learns at otherwise.
        data_root: Folder of packed sites.
        runs: Folder of runs: what was trained without a site, the records and a figure of how reliable stated
            regions are go below it.
        out: Folder to write what ships to, both artifacts and their card; None trains neither.

    Raises:
        FplocError: If a site is not packed, or is no target of the protocol.
    """
    there = packed_sites(data_root)
    if out is not None:
        _require(POOLED_SITES, there, data_root)
    protocol = protocol_of(POOLED.protocol)
    chosen = [one for one in POOLED_SITES if protocol.admits(one) and one in there]
    done: list[_Scored] = []
    for site in track(chosen if sites is None else sites, "leave one out"):
        protocol.check_target(site)
        if site not in there:
            raise UnknownNameError("--sites", site, known=there, way_out="build it with `fploc data build`")
        artifact = _without(site, data_root)
        artifact.save(artifacts_folder(runs))
        done.append(_scored(artifact, site, data_root))
    if out is not None:
        _pooled(data_root).save(out)
        source_only = _source_only(data_root)
        source_only.save(out)
        done += [_scored(source_only, site, data_root) for site in ("conference-room", *chosen)]
    records = [record for one in done for record in one.records]
    if out is not None:
        with whole(out / CARD) as part:
            part.write_text(model_card(records), encoding="utf-8")
    folder = runs / MODEL
    folder.mkdir(parents=True, exist_ok=True)
    write_records(records, folder / RECORDS)
    regions = {name: nees for one in done for name, nees in one.nees.items()}
    plot_reliability(regions, f"{DEFAULT}, at places that it did not see").savefig(folder / RELIABILITY)
    return records


@dataclass(frozen=True)
class _Scored:
    """What the method made of a site.

    Args:
        records: The scores.
        nees: eᵀP⁻¹e of every fix of a device, shape (n,), by protocol, site and device.
    """

    records: list[Record]
    nees: dict[str, NDArray[np.float64]]


def _require(sites: Sequence[str], there: Sequence[str], data_root: Path) -> None:
    missing = [site for site in sites if site not in there]
    if missing:
        raise MissingFileError(
            data_root,
            expected=f"all sites that the model learns at, also {', '.join(missing)}",
            way_out=f"build them with `fploc data build --sites {','.join(missing)}`",
        )


def _without(site: str, data_root: Path) -> Artifact:
    """Return the default method that knows nothing of the place of ``site``."""
    request = EvaluationRequest(POOLED.protocol, site)
    protocol, target = protocol_of(POOLED.protocol), read_packed(data_root, site)
    sources = every_source_recording(request, data_root)
    hashed = data_hash(*learned_and_tested(protocol, target, data_root))
    return _trained(leave_one_out_key(site), sources, data_root, hashed, model_command(site))


def _pooled(data_root: Path) -> Artifact:
    """Return the default method that learned at all local public sites."""
    packed = [read_packed(data_root, site) for site in POOLED_SITES]
    sources = [SourceRecordings(one.recordings(), one.site, one.plan) for one in packed]
    return _trained(POOLED, sources, data_root, data_hash(*packed), SHIPPING_COMMAND)


def _source_only(data_root: Path) -> Artifact:
    """Return the default method that learned at the source alone."""
    packed = read_packed(data_root, PUBLIC_SOURCE)
    recordings = protocol_of(SOURCE_ONLY.protocol).training(packed)
    sources = [SourceRecordings(recordings, packed.site, packed.plan)]
    return _trained(SOURCE_ONLY, sources, data_root, data_hash(packed), SHIPPING_COMMAND)


def _trained(
    key: ArtifactKey, sources: Sequence[SourceRecordings], data_root: Path, hashed: str, command: str
) -> Artifact:
    learner = LearnedGrid()
    offsets = fit_pooled_offsets(learner.default_calibration, sources)
    method = fitted_on(learner, sources, offsets)
    assert isinstance(method, LearnedGridFilter)
    return stored(
        method,
        offsets,
        key,
        sites={one.site.name: read_packed(data_root, one.site.name).manifest_hash for one in sources},
        places={one.site.name: one.site.place for one in sources},
        recordings=tuple(one.key for source in sources for one in source.recordings),
        data_hash=hashed,
        command=command,
    )


def _scored(artifact: Artifact, site: str, data_root: Path) -> _Scored:
    """Return what the method of an artifact makes of a site."""
    packed = read_packed(data_root, site)
    offsets = offsets_of(artifact)
    request = EvaluationRequest(
        artifact.key.protocol, site, calibration=offsets.estimator, labels=REPAIRED, seed=SEED
    )
    method = restored(artifact).for_plan(packed.plan)
    tracks = tracks_of(method, request, data_root, offsets=offsets)
    records = records_of(DEFAULT, request, tracks, artifact=str(artifact.key.folder(Path())))
    nees = {
        f"{request.protocol}, {site} {device}": np.concatenate(
            [
                normalised_errors(one.unfiltered, one.recording.labels_m(REPAIRED))
                for one in tracks
                if one.recording.device == device
            ]
        )
        for device in sorted({one.recording.device for one in tracks})
    }
    return _Scored([one for one in records if one.filter == OWN], nees)
