"""Building packed sites: raw files in, checked tables, plan, splits and manifest out."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fploc.datasets.croissant import write_croissant
from fploc.datasets.lap_rows import LapRows, as_table, lap_rows, link_rows
from fploc.datasets.manifest import SourceHash, make_manifest
from fploc.datasets.packed import MANIFEST, PLAN, SITE, SPLITS, WALLS, packed_folder, read_manifest
from fploc.datasets.source_files import blob_sha1
from fploc.datasets.splits import make_splits, splits_to_json
from fploc.errors import BadFileError, FplocError, HashMismatchError, MissingFileError
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import render_plan
from fploc.raw.long_table import read_long_table
from fploc.schema import DEVICE_LINKS, INTERVALS, READINGS, SCHEMA_VERSION, Table
from fploc.sites.registry import FileRef, SiteSpec, load_spec

# Raised whenever the same sources give other packed data.
BUILD_VERSION = 1


@dataclass(frozen=True)
class BuildReport:
    """What became of one site.

    Args:
        site: Its name.
        folder: The packed site.
        state: ``built``; ``unchanged`` (nothing that it depends on has changed); ``absent`` (the source has
            none of its recordings).
        missing: Files that the site file lists and the source lacks.
        totals: Counts by device, as in the manifest; empty where absent.
        seconds: Time taken.
    """

    site: str
    folder: Path
    state: str
    missing: tuple[str, ...]
    totals: dict[str, Any]
    seconds: float


def build_sites(source: Path | None, data_root: Path, sites: Sequence[str | Path]) -> list[BuildReport]:
    """Build the packed sites below ``<data_root>/packed/``, each at once or not at all.

    Args:
        source: The public data, laid out ``<revision>/<path>``; None where all sites are a user's own.
        data_root: Where packed sites go.
        sites: Names of the registry, or paths of site files.

    Raises:
        FplocError: For anything wrong with a site file, a source file, or the room to write; what was
            packed before stays as it is.
    """
    return [build_site(load_spec(site), source, data_root) for site in sites]


def build_site(spec: SiteSpec, source: Path | None, data_root: Path) -> BuildReport:
    """Build one packed site; see ``build_sites``."""
    started = time.perf_counter()
    folder = packed_folder(data_root, spec.site.name)
    present, missing = _present(spec, source)
    if not any(recording.files[0] in present for recording in spec.recordings):
        return _report(spec, folder, "absent", missing, {}, started)
    sources = [_hashed(file, path) for file, path in present.items()]
    key = _build_key(spec, sources)
    packed_before = _manifest_of(folder)
    if packed_before is not None and packed_before.get("build_key") == key:
        return _report(spec, folder, "unchanged", missing, packed_before["totals"], started)
    if spec.plan.file not in present:
        raise MissingFileError(
            spec.plan.file.name,
            expected=f"the floor plan of {spec.site.name}",
            way_out="fetch it with `fploc data download`, or complete the folder given with --from",
        )
    with _all_or_nothing(folder) as temporary:
        manifest = _write(spec, present, missing, sources, key, temporary)
    return _report(spec, folder, "built", missing, manifest["totals"], started)


def _present(spec: SiteSpec, source: Path | None) -> tuple[dict[FileRef, Path], list[str]]:
    located = {file: spec.locate(file, source) for file in spec.files}
    present = {file: path for file, path in located.items() if path.is_file()}
    return present, [file.name for file in located if file not in present]


def _hashed(file: FileRef, path: Path) -> SourceHash:
    try:
        contents = path.read_bytes()
    except OSError as error:
        raise BadFileError(
            path,
            "whole file",
            value=error.strerror or str(error),
            expected="a file that can be read",
            way_out="check its permissions, or copy it again",
        ) from error
    found = blob_sha1(contents)
    if file.blob_sha1 is not None and found != file.blob_sha1:
        raise HashMismatchError(
            path,
            algorithm="git blob SHA-1",
            found=found,
            expected=file.blob_sha1,
            way_out="fetch the file again: it is not the one that the site file names",
        )
    return SourceHash(file=file, blob_sha1=found, size=len(contents))


def _build_key(spec: SiteSpec, sources: Sequence[SourceHash]) -> str:
    depends_on = {
        "build_version": BUILD_VERSION,
        "schema_version": SCHEMA_VERSION,
        "registry": spec.sha256,
        "sources": sorted([source.file.name, source.blob_sha1] for source in sources),
    }
    return hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()


def _manifest_of(folder: Path) -> dict[str, Any] | None:
    try:
        manifest = read_manifest(folder)
    except FplocError:
        return None
    return manifest if all((folder / name).is_file() for name in manifest["files"]) else None


def _write(
    spec: SiteSpec,
    present: dict[FileRef, Path],
    missing: Sequence[str],
    sources: Sequence[SourceHash],
    key: str,
    folder: Path,
) -> dict[str, Any]:
    """Write all files of the packed site into ``folder``; return its manifest."""
    table = spec.long_table
    long_table = read_long_table(present[table]) if table is not None and table in present else None
    kept = [recording for recording in spec.recordings if recording.files[0] in present]
    laps: list[LapRows] = [
        lap_rows(
            spec,
            recording,
            main=present[recording.files[0]],
            raw=None if recording.raw is None else present.get(recording.raw),
            long_table=long_table,
        )
        for recording in kept
    ]
    links = [link_rows(link, present[link.file]) for link in spec.links if link.file in present]
    _write_table(READINGS, [lap.readings for lap in laps], folder)
    _write_table(INTERVALS, [lap.intervals for lap in laps], folder)
    _write_table(DEVICE_LINKS, [rows for rows, _ in links], folder)
    plan = _render(spec, present[spec.plan.file])
    plan.write(folder / PLAN, folder / WALLS)
    _write_json(_site_document(spec, plan), folder / SITE)
    _write_json(splits_to_json(make_splits(kept)), folder / SPLITS)
    packed = sorted(path for path in folder.iterdir() if path.is_file())
    manifest = make_manifest(
        site=spec.site.name,
        made_up=spec.site.made_up,
        schema_version=SCHEMA_VERSION,
        build_key=key,
        registry_sha256=spec.sha256,
        sources=sources,
        missing=missing,
        recordings=[lap.counts for lap in laps],
        links=[counts for _, counts in links],
        files={path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in packed},
    )
    _write_json(manifest, folder / MANIFEST)
    write_croissant(folder)
    return manifest


def _write_table(table: Table, frames: Sequence[pd.DataFrame], folder: Path) -> None:
    empty = pd.DataFrame({column.name: [] for column in table.columns})
    frame = pd.concat(frames, ignore_index=True) if frames else as_table(empty, table)
    path = folder / f"{table.name}.parquet"
    table.check(frame, str(path)).to_parquet(path, index=False)


def _write_json(document: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _render(spec: SiteSpec, image: Path) -> FloorPlan:
    plan = spec.plan
    return render_plan(
        image,
        native_from_metres=plan.native_from_metres,
        origin_m=plan.origin_m,
        size_px=plan.size_px,
        not_walls_m=plan.not_walls_m,
        blank_boxes_px=plan.blank_boxes_px,
        metres_per_pixel=plan.metres_per_pixel,
        thinnest_wall_m=plan.thinnest_wall_m,
        name=spec.site.name,
    )


def _site_document(spec: SiteSpec, plan: FloorPlan) -> dict[str, Any]:
    """Return site.json: all that a reader without this package needs beside the tables."""
    site = spec.site
    return {
        "name": site.name,
        "description": spec.description,
        "place": site.place,
        "made_up": site.made_up,
        "frame": "metres, x right, y up",
        "device_height_m": site.device_height_m,
        "access_points": [
            {"name": ap.name, "mac": ap.mac, "x_m": ap.x_m, "y_m": ap.y_m, "height_m": ap.height_m}
            for ap in site.access_points
        ],
        "access_points_origin": spec.access_points_origin,
        "plan": {
            "image": PLAN,
            "walls": f"{WALLS} (0 wall, 255 free)",
            "pixels_from_metres": plan.georeference.pixels_from_metres.tolist(),
            "convention": "(column, row) = M (x, y, 1); integers are pixel centres, rows count downwards",
            "metres_per_pixel": spec.plan.metres_per_pixel,
            "origin_m": list(spec.plan.origin_m),
            "source": spec.plan.file.name,
            "estimated_error_m": spec.plan.estimated_error_m,
            "notes": spec.plan.notes,
        },
        "repairs": {
            repair.name: {"kind": repair.kind, "constants": dict(repair.constants), "origin": repair.origin}
            for repair in spec.repairs.values()
        },
        "faults": [
            {"where": fault.where, "what": fault.what, "verdict": fault.verdict} for fault in spec.faults
        ],
    }


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[Path]:
    """Yield a new folder beside ``folder`` that takes its place at the end, or is removed on any error.

    Raises:
        FplocError: If the disk is full or not writable.
    """
    temporary = folder.with_name(f".{folder.name}.partial")
    replaced = folder.with_name(f".{folder.name}.replaced")
    try:
        try:
            for leftover in (temporary, replaced):
                shutil.rmtree(leftover, ignore_errors=True)
            temporary.mkdir(parents=True)
            yield temporary
            if folder.exists():
                folder.rename(replaced)
            temporary.rename(folder)
        except OSError as error:
            raise FplocError(
                str(folder),
                value=error.strerror or str(error),
                expected="a folder with room to write the packed site",
                way_out="free some space, or name another folder with --data-root; nothing was changed",
            ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(replaced, ignore_errors=True)


def _report(
    spec: SiteSpec,
    folder: Path,
    state: str,
    missing: Sequence[str],
    totals: dict[str, Any],
    started: float,
) -> BuildReport:
    return BuildReport(
        site=spec.site.name,
        folder=folder,
        state=state,
        missing=tuple(missing),
        totals=totals,
        seconds=time.perf_counter() - started,
    )
