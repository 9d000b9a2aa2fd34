"""``fploc synthesize``: what the trained generator says of a site, on maps and beside measurements."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.artifacts import ArtifactKey, load_artifact
from fploc.calibration.offsets import RangeOffsets, fit_offsets
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import MeasuredIntervals
from fploc.errors import FplocError
from fploc.evaluation.generator_match import MatchStatistics, match_statistics
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import finite_or_none
from fploc.evaluation.revision import running_commit
from fploc.experiments.preset import read_preset
from fploc.experiments.scoring import artifacts_folder, data_hash, reproduce_command
from fploc.experiments.training import virtual_site
from fploc.files import whole
from fploc.floorplan.grid import PlaceGrid
from fploc.models.generator import Generator
from fploc.plots.generator_maps import centred_limits, plot_generator_maps, shown_limits
from fploc.virtual.dropout import Dropout
from fploc.virtual.maps import distribution_between, generator_maps
from fploc.virtual.site import VirtualSite

Floats = NDArray[np.float64]

PATH_STEP_M = 0.5
DOTS_PER_INCH = 110
FIGURES = (RANGE_MAP, RSS_MAP, RANGE_MISS, RSS_MISS) = (
    "range-error.png",
    "rss.png",
    "range-error-miss.png",
    "rss-miss.png",
)
HELD_OUT = "held-out recordings of the source"
LOOKING = "zero-shot site: for looking, never for choosing"
MATCH = "match.json"
MEASURED, GENERATED, MEAN_ONLY = "measured", "generator", "mean only (paper)"
ALL = "all"


@dataclass(frozen=True, eq=False)
class Readings:
    """Measured and generated readings at the same places; NaN where an access point was not heard.

    The kinds of data are ``MEASURED``, ``GENERATED`` (a sample for each measured reading) and ``MEAN_ONLY``
    (what the generator expects there: the paper's generator has no other output).

    Args:
        places_m: Shape (N, 2), metres, site frame.
        errors_m: Range minus true distance by kind of data, shape (N, A) each, metres.
        rss_dbm: Signal strength by kind of data, shape (N, A) each, dBm.
    """

    places_m: Floats
    errors_m: dict[str, Floats]
    rss_dbm: dict[str, Floats]


@dataclass(frozen=True)
class Synthesis:
    """What was written for a site.

    Args:
        files: Figures and ``match.json``, in the order in which they are worth a look.
        match: Contents of ``match.json``.
    """

    files: tuple[Path, ...]
    match: dict[str, Any]


def synthesize(
    site: str, *, source: str, preset_name: str, seed: int, data_root: Path, runs: Path, out: Path
) -> Synthesis:
    """Draw the generator's maps of a site and lay its samples beside the site's labelled measurements.

    Of the source only its ``test`` recordings are compared, which the generator has not learned from. The
    measurements of any other site are for looking: nothing may be chosen by them.

    Args:
        site: Packed site.
        source: Packed site that the generator learned on.
        preset_name: Preset that trained it.
        seed: Of its training, and of the samples.
        data_root: Folder of packed sites.
        runs: Folder of runs, with the artifacts.
        out: Folder to write.

    Raises:
        FplocError: If preset, data or artifact are not there, or ``out`` cannot be written.
    """
    preset = read_preset(preset_name)
    origin, target = read_packed(data_root, source), read_packed(data_root, site)
    key = ArtifactKey("generator", "seen", source, preset.name, seed)
    artifact = load_artifact(
        artifacts_folder(runs),
        key,
        data_hash=data_hash(origin),
        command=reproduce_command(preset.name, source),
    )
    generator = artifact.networks["generator"]
    assert isinstance(generator, Generator)
    dropout = Dropout(tuple(artifact.constants["heard_shares"]))
    virtual = virtual_site(target, generator, dropout, preset)
    offsets = fit_offsets(
        preset.calibration, protocol_of("seen", source).training(origin), origin.site, origin.plan
    )
    recordings = compared_recordings(target, source, preset.labels)
    readings = _readings(target, recordings, virtual, offsets, preset.labels, seed) if recordings else None
    names = [one.name for one in target.site.access_points]
    match = {
        "site": site,
        "made_up": target.site.made_up,
        "kind": kind_of(target, origin),
        "source": source,
        "preset": preset.name,
        "seed": seed,
        "labels": preset.labels,
        "calibration": offsets.estimator,
        "offset_m": offsets.offset_m,
        "recordings": [f"device {one.device} {one.name}" for one in recordings],
        "artifact": str(key.folder(Path())),
        "data_hash": data_hash(*{one.site.name: one for one in (origin, target)}.values()),
        "commit": running_commit(),
        "rows": [] if readings is None else match_rows(names, readings),
    }
    figures = _maps(target, virtual, source)
    if readings is not None:
        figures |= _path_maps(target, readings, kind_of(target, origin))
    return Synthesis(_write(figures, match, out), match)


def kind_of(target: PackedSite, source: PackedSite) -> str:
    """Return what a comparison at ``target`` may be used for."""
    if target.site.name == source.site.name:
        return HELD_OUT
    same_floor = f", on the floor of {source.site.name}" if target.site.place == source.site.place else ""
    labels = target.intervals[["x_published_m", "x_repaired_m"]].notna().any()
    reconstructed = ", positions reconstructed" if labels.tolist() == [False, True] else ""
    return f"{LOOKING}{same_floor}{reconstructed}"


def compared_recordings(target: PackedSite, source: str, labels: str) -> list[Recording]:
    """Return the recordings with positions to compare with: held-out ones of the source, all of other sites."""
    recordings = target.recordings()
    if target.site.name == source:
        recordings = [one for one in recordings if (one.device, one.name) in target.splits.test]
    return [one for one in recordings if _has_labels(one, labels)]


def match_rows(names: Sequence[str], readings: Readings) -> list[dict[str, Any]]:
    """Return a row for each access point that was heard and kind of data, and for all access points together.

    Args:
        names: Of the access points, A.
        readings: What is compared.
    """
    columns: list[int] = np.flatnonzero(np.isfinite(readings.errors_m[MEASURED]).any(axis=0)).tolist()
    return [
        *_rows_of([names[index] for index in columns], readings, lambda values: values[:, columns]),
        *_rows_of([ALL], readings, lambda values: values.reshape(-1, 1)),
    ]


def _rows_of(
    labels: Sequence[str], readings: Readings, columns: Callable[[Floats], Floats]
) -> list[dict[str, Any]]:
    """Return rows for each of ``labels``: ``columns`` makes arrays (N, A) ones with a column for each."""
    expected = columns(readings.errors_m[MEAN_ONLY])
    by_kind = {
        kind: match_statistics(columns(readings.errors_m[kind]), expected, columns(readings.rss_dbm[kind]))
        for kind in (MEASURED, GENERATED, MEAN_ONLY)
    }
    return [
        {"access_point": label, "data": kind, **_row(one, by_kind[MEASURED], index)}
        for index, label in enumerate(labels)
        for kind, one in by_kind.items()
    ]


def _row(statistics: MatchStatistics, measured: MatchStatistics, index: int) -> dict[str, Any]:
    values: dict[str, Any] = {
        field.name: finite_or_none(float(getattr(statistics, field.name)[index]))
        for field in fields(MatchStatistics)
    }
    rss_bias_db = float(statistics.rss_dbm[index] - measured.rss_dbm[index])
    return values | {"n": int(statistics.n[index]), "rss_bias_db": rss_bias_db}


def _has_labels(recording: Recording, labels: str) -> bool:
    """Return whether any interval has both a position and a range."""
    known = np.isfinite(recording.labels_m(labels)).all(axis=1)
    return bool((known & recording.heard.any(axis=1)).any())


def _readings(
    target: PackedSite,
    recordings: Sequence[Recording],
    virtual: VirtualSite,
    offsets: RangeOffsets,
    labels: str,
    seed: int,
) -> Readings:
    """Return measured readings, prepared as for training, and generated ones at their places."""
    ranges = [calibrated_plan_ranges(one, target.site, offsets) for one in recordings]
    measured = MeasuredIntervals(recordings, ranges, target.site, target.plan, labels)
    distances = torch.cdist(measured.positions, measured.access_points)
    expected = distribution_between(virtual, measured.positions)
    sampled, sampled_rss = expected.sample(torch.Generator().manual_seed(seed))
    errors = {
        MEASURED: measured.ranges - distances,
        # A calibrated range is never below 0.
        GENERATED: torch.maximum(sampled.view_as(distances), -distances),
        MEAN_ONLY: expected.mean_error().view_as(distances),
    }
    rss = {
        MEASURED: measured.rss,
        GENERATED: sampled_rss.view_as(distances),
        MEAN_ONLY: expected.mean_rss().view_as(distances),
    }

    def heard(values: torch.Tensor) -> Floats:
        return np.where(measured.heard.numpy(), values.double().numpy(), np.nan)

    return Readings(
        places_m=measured.positions.double().numpy(),
        errors_m={kind: heard(values) for kind, values in errors.items()},
        rss_dbm={kind: heard(values) for kind, values in rss.items()},
    )


def _maps(target: PackedSite, virtual: VirtualSite, source: str) -> dict[str, Figure]:
    maps = generator_maps(virtual)
    title = f"{target.site.name}: generator learned on {source}"
    kinds = {
        RANGE_MAP: (maps.range_error_m, "RTT error", "mean of range − distance [m]", "viridis"),
        RSS_MAP: (maps.rss_dbm, "RSS", "mean RSS [dBm]", "plasma"),
    }
    return {
        file: plot_generator_maps(
            target.plan,
            target.site,
            maps.grid,
            values,
            title=f"{title}, mean synthetic {name}",
            label=label,
            colours=colours,
            limits=shown_limits(values),
        )
        for file, (values, name, label, colours) in kinds.items()
    }


def _path_maps(target: PackedSite, readings: Readings, kind: str) -> dict[str, Figure]:
    grid = PlaceGrid.covering(readings.places_m, PATH_STEP_M)
    figures = {}
    for name, values, label in (
        (RANGE_MISS, readings.errors_m, "measured − expected range [m]"),
        (RSS_MISS, readings.rss_dbm, "measured − expected RSS [dB]"),
    ):
        misses = grid.means(readings.places_m, values[MEASURED] - values[MEAN_ONLY])
        figures[name] = plot_generator_maps(
            target.plan,
            target.site,
            grid,
            misses,
            title=f"{target.site.name}: measured minus generated mean\n{kind}",
            label=f"{label}, mean of {PATH_STEP_M} m cells",
            colours="RdBu_r",
            limits=centred_limits(misses),
        )
    return figures


def _write(figures: Mapping[str, Figure], match: Mapping[str, Any], out: Path) -> tuple[Path, ...]:
    """Write figures and ``match.json``, each in one move; figures that are not made any more go."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in FIGURES:
            if name not in figures:
                (out / name).unlink(missing_ok=True)
        for name, figure in figures.items():
            with whole(out / name) as part:
                figure.savefig(part, format="png", dpi=DOTS_PER_INCH)
        with whole(out / MATCH) as part:
            part.write_text(json.dumps(match, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise FplocError(
            str(out),
            value=error.strerror or str(error),
            expected="a folder with room to write to",
            way_out="free some space, or name another folder with --out",
        ) from error
    return (*(out / name for name in figures), out / MATCH)
