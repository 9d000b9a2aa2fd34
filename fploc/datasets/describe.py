"""What the packed sites hold: counts per site and device, and a picture of each site."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError
from fploc.files import whole
from fploc.plots.site_overlay import plot_site_overlay
from fploc.progress import track

Floats = NDArray[np.float64]

# Labels that a repair moved by less than this (root mean square) are drawn once.
_MOVED_M = 0.01
_DOTS_PER_INCH = 110


@dataclass(frozen=True)
class DeviceDescription:
    """What one device recorded at one site.

    Args:
        device: 1 or 2.
        recordings: Number of recordings.
        intervals: Number of de-duplicated reading sets.
        duration_s: Sum over the recordings, seconds.
        access_points: Number of access points heard at least once.
        readings: Number of readings kept.
        ranges: Number of these with a range.
        dropped_sets: Number of reading sets dropped, by reason.
        dropped_readings: Number of readings dropped, alone or with their set, by reason.
        masked: Number of values set to null or flagged, by reason.
        labelled: Number of intervals with a repaired label.
        label_box_m: Least x, least y, greatest x, greatest y of the repaired labels, metres, site frame;
            None without labels.
        label_shift_m: Root mean square distance between published and repaired labels, metres; None
            without published labels.
    """

    device: int
    recordings: int
    intervals: int
    duration_s: float
    access_points: int
    readings: int
    ranges: int
    dropped_sets: dict[str, int]
    dropped_readings: dict[str, int]
    masked: dict[str, int]
    labelled: int
    label_box_m: tuple[float, float, float, float] | None
    label_shift_m: float | None


@dataclass(frozen=True)
class SiteDescription:
    """What a packed site holds: access points set up, ranges between the devices, and each device."""

    site: str
    made_up: bool
    access_points: int
    device_links: int
    devices: tuple[DeviceDescription, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the same as a JSON object."""
        return asdict(self)


def describe(data_root: Path, sites: Sequence[str]) -> list[SiteDescription]:
    """Return what the packed ``sites`` below ``data_root`` hold.

    Raises:
        MissingFileError: If a site is not packed.
        HashMismatchError: If a packed file is not the one that was built.
        BadFileError: If a packed file breaks its contract.
    """
    return [describe_packed(read_packed(data_root, site)) for site in sites]


def table_rows(descriptions: Sequence[SiteDescription]) -> list[dict[str, str]]:
    """Return one row per site and device, ready to print; reasons that count nothing are left out."""
    return [_row(site, device) for site in descriptions for device in site.devices]


def write_overlays(data_root: Path, sites: Sequence[str], out: Path) -> list[Path]:
    """Write ``<site>.png`` into ``out``: plan, access points and a path of each device.

    The path is the recording whose labels were repaired most, else the longest; published and repaired
    labels are both drawn where they differ.

    Raises:
        FplocError: If the pictures cannot be written, and as ``describe``.
    """
    return [
        write_picture(overlay(read_packed(data_root, site)), out / f"{site}.png")
        for site in track(sites, "overlays")
    ]


def overlay(packed: PackedSite) -> Figure:
    """Return the plan of a site with its access points and a path of each device; see ``write_overlays``."""
    return plot_site_overlay(packed.plan, packed.site, _paths(packed.recordings()))


def describe_packed(packed: PackedSite) -> SiteDescription:
    """Return what a packed site holds."""
    recordings = packed.recordings()
    return SiteDescription(
        site=packed.site.name,
        made_up=packed.site.made_up,
        access_points=len(packed.site.access_points),
        device_links=len(packed.device_links),
        devices=tuple(_device(packed, device, own) for device, own in _by_device(recordings).items()),
    )


def _by_device(recordings: Sequence[Recording]) -> dict[int, list[Recording]]:
    devices = sorted({recording.device for recording in recordings})
    return {
        device: [recording for recording in recordings if recording.device == device] for device in devices
    }


def _device(packed: PackedSite, device: int, recordings: Sequence[Recording]) -> DeviceDescription:
    readings = packed.readings[packed.readings["device"] == device]
    totals = packed.manifest["totals"][f"device{device}"]
    published = np.concatenate([recording.published_m for recording in recordings])
    repaired = np.concatenate([recording.repaired_m for recording in recordings])
    labels = repaired[np.isfinite(repaired).all(axis=-1)]
    return DeviceDescription(
        device=device,
        recordings=len(recordings),
        intervals=len(repaired),
        duration_s=float(sum(np.ptp(recording.t_s) for recording in recordings if len(recording))),
        access_points=int(readings["mac"].nunique()),
        readings=len(readings),
        ranges=int(readings["range_slant_m"].notna().sum()),
        dropped_sets=dict(totals["dropped_sets"]),
        dropped_readings=dict(totals["dropped_readings"]),
        masked=dict(totals["masked"]),
        labelled=len(labels),
        label_box_m=_box(labels) if len(labels) else None,
        label_shift_m=_shift_m(published, repaired),
    )


def _box(labels: Floats) -> tuple[float, float, float, float]:
    (x_min, y_min), (x_max, y_max) = labels.min(axis=0), labels.max(axis=0)
    return float(x_min), float(y_min), float(x_max), float(y_max)


def _shift_m(published: Floats, repaired: Floats) -> float | None:
    squares = np.square(published - repaired).sum(axis=-1)
    known = squares[np.isfinite(squares)]
    return float(np.sqrt(known.mean())) if len(known) else None


def _row(site: SiteDescription, device: DeviceDescription) -> dict[str, str]:
    box, shift = device.label_box_m, device.label_shift_m
    return {
        "site": f"{site.site} (made up)" if site.made_up else site.site,
        "device": str(device.device),
        "recordings": str(device.recordings),
        "intervals": f"{device.intervals:,}",
        "minutes": f"{device.duration_s / 60:.1f}",
        "APs": f"{device.access_points} of {site.access_points}",
        "readings": f"{device.readings:,}",
        "dropped sets": reasons_text(device.dropped_sets),
        "dropped readings": reasons_text(device.dropped_readings),
        "masked": reasons_text(device.masked),
        "labels x (m)": "–" if box is None else f"{box[0]:.1f} … {box[2]:.1f}",
        "labels y (m)": "–" if box is None else f"{box[1]:.1f} … {box[3]:.1f}",
        "repair (m)": "–" if shift is None else f"{shift:.2f}",
    }


def reasons_text(counts: Mapping[str, int]) -> str:
    """Return counts by reason in one line, those of 0 left out."""
    named = [f"{reason.replace('_', ' ')} {count:,}" for reason, count in counts.items() if count]
    return "; ".join(named) if named else "0"


def write_picture(figure: Figure, target: Path) -> Path:
    """Write a figure as PNG, in one move, and return its file.

    Raises:
        FplocError: If it cannot be written.
    """
    with writable(target) as part:
        figure.savefig(part, format="png", dpi=_DOTS_PER_INCH)
    return target


@contextmanager
def writable(target: Path) -> Iterator[Path]:
    """Yield a name to write to that becomes ``target`` in one move; its folder is made where it is missing.

    Raises:
        FplocError: If it cannot be written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with whole(target) as part:
            yield part
    except OSError as error:
        raise FplocError(
            str(target),
            value=error.strerror or str(error),
            expected="a folder with room to write to",
            way_out="free some space, or name another folder",
        ) from error


def _paths(recordings: Sequence[Recording]) -> dict[str, Floats]:
    paths: dict[str, Floats] = {}
    for device, own in _by_device(recordings).items():
        shown = max(own, key=_interest)
        name = f"device {device}, {shown.name}"
        shift = _shift_m(shown.published_m, shown.repaired_m)
        if shift is not None and shift < _MOVED_M:
            paths[name] = shown.published_m
        else:
            paths |= {f"{name}, published": shown.published_m, f"{name}, repaired": shown.repaired_m}
    return {name: path for name, path in paths.items() if np.isfinite(path).any()}


def _interest(recording: Recording) -> tuple[float, int]:
    shift = _shift_m(recording.published_m, recording.repaired_m)
    return (0.0 if shift is None or shift < _MOVED_M else shift, len(recording))
