from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fploc.calibration.offsets import (
    FEWEST_READINGS_PER_MAC,
    RangeOffsets,
    SourceRecordings,
    constant_offset,
    fit_offsets,
    fit_pooled_offsets,
)
from fploc.datasets.recordings import Recording
from fploc.errors import BadFileError, FplocError, MissingFileError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.sites.site import AccessPoint, Site

MACS = ("aa:00:00:00:00:01", "aa:00:00:00:00:02")
SITE = Site(
    name="hall",
    place="hall",
    access_points=(AccessPoint("AP1", MACS[0], 1.0, 5.0, 3.0), AccessPoint("AP2", MACS[1], 9.0, 5.0, 2.0)),
    device_height_m=1.0,
)
# A wall at x = 5 m in a hall of 10 m × 10 m, 10 px/m: AP1 sees x < 5, AP2 sees x > 5.
CLEAR_M, BLOCKED_M = (0.6, 1.0), 4.0


def plan() -> FloorPlan:
    walls = np.zeros((100, 100), dtype=bool)
    walls[:, 49:51] = True
    grey = np.where(walls, 0, 255).astype(np.uint8)
    pixels_from_metres = np.array([[10.0, 0.0, -0.5], [0.0, -10.0, 99.5]])
    return FloorPlan("hall", grey, walls, Georeference(pixels_from_metres))


def lap(name: str = "1", seed: int = 0) -> Recording:
    random = np.random.default_rng(seed)
    path = random.uniform((1.0, 1.0), (9.0, 9.0), size=(400, 2))
    path = path[np.abs(path[:, 0] - 5) > 0.3]
    across = np.linalg.norm(path[:, None] - SITE.positions_m, axis=2)
    clear = np.column_stack([path[:, 0] < 5, path[:, 0] > 5])
    slant = np.hypot(across, SITE.height_differences_m) + np.where(clear, CLEAR_M, BLOCKED_M)
    heard = np.ones(slant.shape, dtype=bool)
    return Recording(
        site="hall",
        device=1,
        name=name,
        t_s=np.arange(len(path)) * 0.3,
        slant_m=slant,
        std_m=np.zeros(slant.shape),
        rss_dbm=np.full(slant.shape, -50.0),
        heard=heard,
        published_m=path + 3.0,
        repaired_m=path,
    )


def test_line_of_sight_readings_alone_give_source_mac() -> None:
    offsets = fit_offsets("source-mac", [lap()], SITE, plan())
    assert offsets.by_mac_m == pytest.approx(dict(zip(MACS, CLEAR_M, strict=True)))
    np.testing.assert_allclose(offsets.per_access_point_m(MACS), CLEAR_M)
    assert CLEAR_M[0] <= offsets.offset_m <= CLEAR_M[1]


def test_source_los_is_the_median_over_clear_links() -> None:
    one = lap()
    first = replace(one, heard=one.heard & [True, False], slant_m=one.slant_m * [1.0, 0.0])
    offsets = fit_offsets("source-los", [first], SITE, plan())
    assert offsets.offset_m == pytest.approx(CLEAR_M[0])
    assert offsets.by_mac_m == {}
    assert offsets.recordings == ("hall/1/1",)


def test_source_median_counts_blocked_links_too() -> None:
    one = lap()
    offsets = fit_offsets("source-median", [one], SITE, None)
    true_slant = np.hypot(
        np.linalg.norm(one.repaired_m[:, None] - SITE.positions_m, axis=2), SITE.height_differences_m
    )
    assert offsets.offset_m == pytest.approx(np.median(one.slant_m - true_slant))


def test_a_rarely_heard_access_point_takes_the_offset_of_all() -> None:
    one = lap()
    heard = one.heard.copy()
    rare = np.flatnonzero(one.repaired_m[:, 0] > 5)[FEWEST_READINGS_PER_MAC - 1 :]
    heard[rare, 1] = False
    offsets = fit_offsets("source-mac", [replace(one, heard=heard)], SITE, plan())
    assert list(offsets.by_mac_m) == [MACS[0]]
    assert offsets.per_access_point_m(MACS)[1] == offsets.offset_m


def test_an_unknown_mac_takes_the_offset_of_all() -> None:
    offsets = RangeOffsets("source-mac", 1.5, {MACS[0]: 0.2})
    assert offsets.per_access_point_m([MACS[0], "bb"]).tolist() == [0.2, 1.5]


def test_applying_subtracts_and_stops_at_zero() -> None:
    offsets = RangeOffsets("1.0", 1.0)
    assert offsets.apply(np.array([[0.4, 3.0]]), MACS).tolist() == [[0.0, 2.0]]


@pytest.mark.parametrize(("text", "metres"), [("none", 0.0), ("1.0", 1.0), ("2.4", 2.4), ("-0.5", -0.5)])
def test_a_number_is_taken_as_it_is(text: str, metres: float) -> None:
    assert fit_offsets(text, [], SITE, None) == RangeOffsets(text, metres)


@pytest.mark.parametrize("text", ["", "sauce-los", "1,0", "nan", "inf", "source"])
def test_bad_text_is_named_with_what_is_expected(text: str) -> None:
    with pytest.raises(FplocError, match="source-los, source-median, source-mac, or a finite number"):
        constant_offset(text)


def test_line_of_sight_needs_a_plan() -> None:
    with pytest.raises(FplocError, match="floor plan of hall"):
        fit_offsets("source-los", [lap()], SITE, None)


def test_recordings_without_a_usable_reading_are_refused() -> None:
    one = lap()
    silent = replace(one, heard=np.zeros_like(one.heard))
    unlabelled = replace(one, repaired_m=np.full_like(one.repaired_m, np.nan))
    for bad in (silent, unlabelled):
        with pytest.raises(FplocError, match="readings of hall"):
            fit_offsets("source-los", [bad], SITE, plan())


def test_offsets_survive_the_disk(tmp_path: Path) -> None:
    offsets = fit_offsets("source-mac", [lap("1"), lap("2", seed=4)], SITE, plan())
    path = tmp_path / "offsets.json"
    offsets.save(path)
    assert RangeOffsets.load(path) == offsets
    assert [one.name for one in tmp_path.iterdir()] == ["offsets.json"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"unit": "mm", "estimator": "none", "offset_m": 1, "by_mac_m": {}, "recordings": []}',
        '{"unit": "m", "estimator": "none", "offset_m": NaN, "by_mac_m": {}, "recordings": []}',
        '{"unit": "m", "estimator": "none", "offset_m": "x", "by_mac_m": {}, "recordings": []}',
    ],
)
def test_a_broken_file_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "offsets.json"
    path.write_text(text)
    with pytest.raises(BadFileError, match=r"offsets\.json"):
        RangeOffsets.load(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"offsets\.json"):
        RangeOffsets.load(tmp_path / "offsets.json")


def source(recording: Recording, name: str = "hall", plan_: FloorPlan | None = None) -> SourceRecordings:
    return SourceRecordings([replace(recording, site=name)], replace(SITE, name=name), plan_)


@pytest.mark.parametrize("estimator", ["source-los", "source-median", "source-mac", "none", "1.25"])
def test_one_site_pooled_is_that_site(estimator: str) -> None:
    laps = [lap("1"), lap("2", seed=4)]
    pooled = fit_pooled_offsets(estimator, [SourceRecordings(laps, SITE, plan())])
    assert pooled == fit_offsets(estimator, laps, SITE, plan())


def errors_m(recording: Recording) -> NDArray[np.float64]:
    """Return slant range minus slant distance of every reading, by its definition."""
    across = np.linalg.norm(recording.repaired_m[:, None] - SITE.positions_m, axis=2)
    return (recording.slant_m - np.hypot(across, SITE.height_differences_m)).ravel()


def test_pooled_sites_give_the_median_over_all_readings() -> None:
    """Not the mean of medians, nor the median of medians: the second site has a tenth of the readings."""
    large = lap("1")
    shifted = lap("2", seed=4)
    shifted = replace(shifted, slant_m=shifted.slant_m + 10.0)
    small = shifted.where(np.arange(len(shifted)) < len(large) // 10)
    pooled = fit_pooled_offsets("source-median", [source(large), source(small, "shed")])
    assert pooled.offset_m == np.median(np.concatenate([errors_m(large), errors_m(small)]))
    assert pooled.recordings == ("hall/1/1", "shed/1/2")
    again = fit_pooled_offsets("source-median", [source(small, "shed"), source(large)])
    assert again.offset_m == pooled.offset_m


def test_pooled_sites_look_for_walls_on_their_own_plans() -> None:
    """In the shed no wall is drawn, so that its long ranges count as well."""
    walls = plan()
    bare = FloorPlan("shed", np.full_like(walls.grey, 255), np.zeros_like(walls.walls), walls.georeference)
    one = lap("1")
    pooled = fit_pooled_offsets("source-los", [source(one, "hall", walls), source(one, "shed", bare)])
    clear = np.column_stack([one.repaired_m[:, 0] < 5, one.repaired_m[:, 0] > 5]).ravel()
    expected = np.concatenate([errors_m(one)[clear], errors_m(one)])
    assert pooled.offset_m == pytest.approx(np.median(expected))


def test_access_points_of_pooled_sites_keep_offsets_of_their_own() -> None:
    one = lap("1")
    moved = tuple(replace(ap, mac=f"bb:00:00:00:00:0{i}") for i, ap in enumerate(SITE.access_points))
    shed = SourceRecordings(
        [replace(one, slant_m=one.slant_m + 2.0)], replace(SITE, access_points=moved), plan()
    )
    pooled = fit_pooled_offsets("source-mac", [source(one, "hall", plan()), shed])
    assert pooled.by_mac_m == pytest.approx(
        dict(zip(MACS, CLEAR_M, strict=True))
        | {moved[0].mac: CLEAR_M[0] + 2.0, moved[1].mac: CLEAR_M[1] + 2.0}
    )


def test_sites_without_any_usable_reading_are_named_together() -> None:
    silent = replace(lap(), heard=np.zeros_like(lap().heard))
    with pytest.raises(FplocError, match="readings of hall, shed for --calibration source-median"):
        fit_pooled_offsets("source-median", [source(silent), source(silent, "shed")])
