"""Reading packed sites: checked tables, plan, splits and manifest of one site."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fploc.datasets.recordings import Recording, dense_recordings
from fploc.datasets.splits import Splits, splits_from_json
from fploc.errors import BadFileError, HashMismatchError, MissingFileError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan, read_floor_plan
from fploc.schema import DEVICE_LINKS, INTERVALS, READINGS, SCHEMA_VERSION, Table
from fploc.sites.site import AccessPoint, Site

PACKED = "packed"
MANIFEST = "manifest.json"
SITE = "site.json"
SPLITS = "splits.json"
PLAN = "plan.png"
WALLS = "walls.png"

_REBUILD = "build it with `fploc data build`"


@dataclass(frozen=True, eq=False)
class PackedSite:
    """One packed site in memory.

    Args:
        folder: Where it was read from.
        site: Access points and heights.
        plan: Floor plan and walls, georeferenced.
        readings: Table ``fploc.schema.READINGS``.
        intervals: Table ``fploc.schema.INTERVALS``.
        device_links: Table ``fploc.schema.DEVICE_LINKS``.
        splits: Which recordings are for training, validation and testing.
        info: What ``site.json`` says: faults, repairs, notes, place of the plan.
        manifest: What ``manifest.json`` says: sources, counts by recording, hashes.
        manifest_hash: SHA-256 that stands for these data in artifacts and result records.
    """

    folder: Path
    site: Site
    plan: FloorPlan
    readings: pd.DataFrame
    intervals: pd.DataFrame
    device_links: pd.DataFrame
    splits: Splits
    info: dict[str, Any]
    manifest: dict[str, Any]
    manifest_hash: str

    def recordings(self) -> list[Recording]:
        """Return all recordings as dense arrays, ordered by device and name."""
        return dense_recordings(self.site, self.readings, self.intervals)


def packed_sites(data_root: Path) -> list[str]:
    """Return the names of all packed sites below ``data_root``, sorted.

    Raises:
        MissingFileError: If there is none.
    """
    names = sorted(path.parent.name for path in (data_root / PACKED).glob(f"*/{MANIFEST}"))
    if not names:
        raise MissingFileError(data_root / PACKED, expected="packed sites", way_out=_REBUILD)
    return names


def packed_folder(data_root: Path, site: str) -> Path:
    """Return the folder of a packed site."""
    return data_root / PACKED / site


def read_packed(data_root: Path, site: str) -> PackedSite:
    """Read a packed site and check it: files against the manifest's hashes, tables against the schema.

    Raises:
        MissingFileError: If the site or one of its files is not there.
        BadFileError: If the site was built for another schema version, or a table breaks its contract.
        HashMismatchError: If a file is not the one that was built.
    """
    folder = packed_folder(data_root, site)
    manifest = read_manifest(folder)
    for name, expected in manifest["files"].items():
        found = hashlib.sha256(_bytes(folder / name)).hexdigest()
        if found != expected:
            raise HashMismatchError(
                folder / name,
                algorithm="SHA-256",
                found=found,
                expected=expected,
                way_out="the file was changed after the build: rebuild with `fploc data build`",
            )
    info = json.loads(_bytes(folder / SITE))
    return PackedSite(
        folder=folder,
        site=_site(info),
        plan=read_floor_plan(
            folder / PLAN, folder / WALLS, Georeference(info["plan"]["pixels_from_metres"]), name=info["name"]
        ),
        readings=_table(READINGS, folder),
        intervals=_table(INTERVALS, folder),
        device_links=_table(DEVICE_LINKS, folder),
        splits=splits_from_json(json.loads(_bytes(folder / SPLITS))),
        info=info,
        manifest=manifest,
        manifest_hash=manifest_hash(manifest),
    )


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a packed site.

    Raises:
        MissingFileError: If there is none.
        BadFileError: If it is unreadable, or of another schema version.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise MissingFileError(folder, expected="a packed site", way_out=_REBUILD)
    try:
        manifest = json.loads(path.read_bytes())
        version, _ = manifest["schema_version"], manifest["files"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadFileError(
            path, "whole file", value=repr(error), expected="a manifest of a packed site", way_out=_REBUILD
        ) from error
    if version != SCHEMA_VERSION:
        raise BadFileError(
            path, "schema_version", value=version, expected=str(SCHEMA_VERSION), way_out="re" + _REBUILD
        )
    return dict(manifest)


def manifest_hash(manifest: dict[str, Any]) -> str:
    """Return the SHA-256 over a manifest's contents, keys sorted."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _bytes(path: Path) -> bytes:
    if not path.is_file():
        raise MissingFileError(path, expected="a file of a packed site", way_out="re" + _REBUILD)
    return path.read_bytes()


def _table(table: Table, folder: Path) -> pd.DataFrame:
    path = folder / f"{table.name}.parquet"
    return table.check(pd.read_parquet(path), str(path))


def _site(info: dict[str, Any]) -> Site:
    return Site(
        name=info["name"],
        place=info["place"],
        access_points=tuple(
            AccessPoint(name=ap["name"], mac=ap["mac"], x_m=ap["x_m"], y_m=ap["y_m"], height_m=ap["height_m"])
            for ap in info["access_points"]
        ),
        device_height_m=info["device_height_m"],
        made_up=info["made_up"],
    )
