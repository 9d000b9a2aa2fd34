"""Every public lap of the local copy: raw log and cleaned recording of one lap tell the same."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fploc.raw.cleaned import read_cleaned
from fploc.raw.device_link import read_device_link
from fploc.raw.lap import Lap
from fploc.raw.phone_log import read_phone_log
from fploc.repair.readings import drop_repeats
from fploc.sites.registry import RecordingSpec, SiteSpec, known_sites, load_spec
from fploc.sites.site import Site

# Outliers that the authors lowered by whole metres, by hand, in the cleaned laps (the mall's site file says so).
LOWERED_BY_HAND = {"724": 30, "924": 9, "1024": 2, "1124": 14}
# A lap whose cleaned file keeps one reading set per rounded second of the raw log.
SUBSAMPLED = {"lab3"}


@cache
def laps_in_both_forms(source: Path) -> tuple[tuple[SiteSpec, RecordingSpec], ...]:
    pairs = [(spec, recording) for spec in map(load_spec, known_sites()) for recording in spec.recordings]
    return tuple(
        (spec, recording)
        for spec, recording in pairs
        if len(recording.files) == 2 and all(spec.locate(file, source).is_file() for file in recording.files)
    )


def dense(lap: Lap, site: Site) -> NDArray[np.float64]:
    """Range in space, std and RSS, shape (T, A, 3); 0 where the lap has none or the range is not above h."""
    column = {mac: index for index, mac in enumerate(site.macs)}
    cells = np.zeros((len(lap.sets), len(column), 3))
    at = (
        np.searchsorted(lap.sets.index, lap.readings["set"]),
        lap.readings["mac"].map(column).to_numpy(),
    )
    cells[at] = lap.readings[["range_m", "std_m", "rss_dbm"]].to_numpy()
    h = site.height_differences_m
    # The authors' projection writes 0 for ranges that are not longer than the height difference.
    cells[cells[..., 0] <= (h if lap.is_slant else 0.0)] = 0.0
    if not lap.is_slant:
        cells[..., 0] = np.where(cells[..., 0] > 0, np.hypot(cells[..., 0], h), 0.0)
    return cells


def aligned(cleaned: Lap, raw: Lap, site: Site, *, subsampled: bool) -> tuple[NDArray[np.float64], ...]:
    """Return both laps set by set: by order, or by equal content where the cleaned lap is a sample."""
    if not subsampled and len(cleaned.sets) != len(raw.sets):
        cleaned, raw = drop_repeats(cleaned)[0], drop_repeats(raw)[0]
    left, right = dense(cleaned, site), dense(raw, site)
    if not subsampled:
        return left, right
    found = {key(row): number for number, row in enumerate(right)}
    return left, right[[found[key(row)] for row in left]]


def key(cells: NDArray[np.float64]) -> bytes:
    """Return ranges (whole millimetres) and RSS of a reading set (A, 3) as bytes."""
    return np.round(cells[:, [0, 2]] * [1000, 1]).astype(np.int64).tobytes()


def test_raw_logs_and_cleaned_laps_agree(source: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Range in space within 1 mm, RSS and std equal, for every reading of every lap that exists twice."""
    pairs = laps_in_both_forms(source)
    compared: dict[str, int] = {}
    for spec, recording in pairs:
        cleaned_file, raw_file = (spec.locate(file, source) for file in recording.files)
        cleaned = read_cleaned(cleaned_file, spec.site, numbering=spec.numbering)
        raw = read_phone_log(raw_file, spec.site)
        ours, theirs = aligned(cleaned, raw, spec.site, subsampled=recording.name in SUBSAMPLED)
        name = f"{spec.site.name} {recording.name}"
        assert ours.shape == theirs.shape, name
        apart = np.abs(ours[..., 0] - theirs[..., 0]) > 1e-3
        assert apart.sum() == LOWERED_BY_HAND.get(recording.name, 0), name
        both = (ours[..., 0] > 0) & (theirs[..., 0] > 0)
        np.testing.assert_array_equal(both | apart, ours[..., 0] > 0, err_msg=name)
        np.testing.assert_array_equal(ours[..., 2], theirs[..., 2], err_msg=name)
        np.testing.assert_allclose(ours[..., 1], theirs[..., 1], atol=1e-6, err_msg=name)
        compared[name] = int(both.sum())
        assert compared[name] > 1_000, name
    with capsys.disabled():
        sys.stdout.write(
            f"\n{sum(compared.values())} readings of {len(compared)} laps compared: raw = cleaned\n"
        )
    assert len(compared) == 41
    assert sum(compared.values()) > 345_000


def test_every_link_log_is_read(source: Path) -> None:
    logs = [
        read_device_link(spec.locate(link.file, source))
        for spec in map(load_spec, known_sites())
        for link in spec.links
        if spec.locate(link.file, source).is_file()
    ]
    assert len(logs) == 18
    assert sum(len(log) for log in logs) == 6095
    assert all((log["rss_dbm"] < 0).all() for log in logs)
