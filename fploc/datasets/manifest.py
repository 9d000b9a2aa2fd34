"""The manifest of a packed site: what it was made from and what was dropped, recording by recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from fploc.sites.registry import FileRef


@dataclass(frozen=True)
class SourceHash:
    """One file that was read, and the git blob SHA-1 of its contents."""

    file: FileRef
    blob_sha1: str
    size: int


@dataclass(frozen=True)
class RecordingCounts:
    """What became of one recording.

    Args:
        device: 1 or 2.
        recording: Name of the lap's file.
        rows: Reading sets in the file.
        readings_in_file: Access points heard, over all sets.
        intervals: Reading sets kept.
        readings_kept: Readings kept.
        dropped_sets: Reading sets dropped, by reason; each of them in one reason.
        dropped_readings: Readings dropped, by reason: with their set, or alone.
        masked: Values set to null or flagged in what was kept, by reason.
        clock: What was done to the time stamps.
        labels: Where published and repaired labels come from.
        true_distance_m: Median difference, by access point, between the published true distance and that
            from label to access point.
    """

    device: int
    recording: str
    rows: int
    readings_in_file: int
    intervals: int
    readings_kept: int
    dropped_sets: Mapping[str, int]
    dropped_readings: Mapping[str, int]
    masked: Mapping[str, int]
    clock: str
    labels: str
    true_distance_m: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class LinkCounts:
    """What became of one log of the link between the devices."""

    lap: str
    rows: int
    kept: int
    dropped: Mapping[str, int]
    masked: Mapping[str, int]
    clock: str


def make_manifest(
    *,
    site: str,
    made_up: bool,
    schema_version: int,
    build_key: str,
    registry_sha256: str,
    sources: Iterable[SourceHash],
    missing: Iterable[str],
    recordings: Iterable[RecordingCounts],
    links: Iterable[LinkCounts],
    files: Mapping[str, str],
) -> dict[str, Any]:
    """Return the manifest as it stands in manifest.json.

    Args:
        site: Name of the site.
        made_up: True where the building was generated.
        schema_version: Of the tables.
        build_key: Hash over everything that the build depends on; equal keys need no new build.
        registry_sha256: Hash of the site file.
        sources: Every file that was read.
        missing: Names of files that the site file lists and the source lacks.
        recordings: Counts by recording.
        links: Counts by link log.
        files: SHA-256 of every packed file by name.
    """
    recordings, links = list(recordings), list(links)
    return {
        "site": site,
        "made_up": made_up,
        "schema_version": schema_version,
        "build_key": build_key,
        "registry_sha256": registry_sha256,
        "sources": [
            {"path": source.file.name, "git_blob_sha1": source.blob_sha1, "bytes": source.size}
            for source in sources
        ],
        "missing": list(missing),
        "totals": {
            f"device{device}": _totals([counts for counts in recordings if counts.device == device])
            for device in sorted({counts.device for counts in recordings})
        },
        "recordings": [asdict(counts) for counts in recordings],
        "device_links": [asdict(counts) for counts in links],
        "files": dict(files),
    }


def _totals(recordings: list[RecordingCounts]) -> dict[str, Any]:
    return {
        "recordings": len(recordings),
        "rows": sum(counts.rows for counts in recordings),
        "readings_in_file": sum(counts.readings_in_file for counts in recordings),
        "intervals": sum(counts.intervals for counts in recordings),
        "readings_kept": sum(counts.readings_kept for counts in recordings),
        "dropped_sets": _sum(counts.dropped_sets for counts in recordings),
        "dropped_readings": _sum(counts.dropped_readings for counts in recordings),
        "masked": _sum(counts.masked for counts in recordings),
    }


def _sum(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(total)
