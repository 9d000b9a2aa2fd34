from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.errors import FplocError
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import free_space, line_of_sight, render_plan, wall_crossings
from fploc.raw.ap_sheet import read_ap_sheet
from fploc.raw.device_link import read_device_link
from fploc.raw.phone_log import read_phone_log
from fploc.sites.made_up import (
    LINE_OF_SIGHT_OFFSET_M,
    LINK_OFFSET_M,
    MadeUpBuilding,
    MadeUpRecording,
    link_log,
    made_up_site,
    make_building,
    walk,
    walls_between,
)
from fploc.sites.registry import SiteSpec, load_spec

SEEDS = (0, 7, 1234)


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> SiteSpec:
    return load_spec(made_up_site(7, tmp_path_factory.mktemp("made-up"), laps=2, duration_s=60.0))


def plan_of(spec: SiteSpec) -> FloorPlan:
    return render_plan(
        spec.locate(spec.plan.file, None),
        native_from_metres=spec.plan.native_from_metres,
        origin_m=spec.plan.origin_m,
        size_px=spec.plan.size_px,
        not_walls_m=spec.plan.not_walls_m,
        blank_boxes_px=spec.plan.blank_boxes_px,
        name=spec.site.name,
    )


def links(building: MadeUpBuilding, recording: MadeUpRecording) -> tuple[np.ndarray, np.ndarray]:
    count = len(building.site.access_points)
    starts = np.tile(building.site.positions_m, (len(recording.t_s), 1))
    return starts, np.repeat(recording.position_m, count, axis=0)


def range_errors(building: MadeUpBuilding, recording: MadeUpRecording) -> np.ndarray:
    """Measured minus true range in space, shape (T, A); NaN where not heard or an outlier."""
    flat = np.linalg.norm(recording.position_m[:, None] - building.site.positions_m, axis=-1)
    errors = recording.range_m - np.hypot(flat, building.site.height_differences_m)
    return np.where(recording.heard & (recording.range_m < 100), errors, np.nan)


@pytest.mark.parametrize("seed", SEEDS)
def test_site(seed: int) -> None:
    site = make_building(seed).site
    assert site.made_up
    assert site.name == site.place == f"made-up-{seed}"
    assert 6 <= len(site.access_points) <= 8
    assert len(set(site.macs)) == len(site.macs)
    assert all(mac.startswith("02:") for mac in site.macs)
    apart = np.linalg.norm(site.positions_m[:, None] - site.positions_m, axis=-1)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 2.0


def test_seeds_differ_and_one_seed_does_not() -> None:
    first, again, other = make_building(3), make_building(3), make_building(4)
    np.testing.assert_array_equal(first.walls_m, again.walls_m)
    assert first.site == again.site
    assert first.walls_m.shape != other.walls_m.shape or not np.array_equal(first.walls_m, other.walls_m)
    assert not set(first.site.macs) & set(other.site.macs)


@pytest.mark.parametrize("seed", [-1, 2**24])
def test_seed_out_of_range(seed: int) -> None:
    with pytest.raises(FplocError, match="seed"):
        make_building(seed)


@pytest.mark.parametrize(("laps", "duration_s"), [(0, 60.0), (1, 1.0), (1, float("nan"))])
def test_too_short(tmp_path: Path, laps: int, duration_s: float) -> None:
    with pytest.raises(FplocError, match="of a made-up building"):
        made_up_site(7, tmp_path, laps=laps, duration_s=duration_s)
    assert list(tmp_path.iterdir()) == []


def test_same_bytes(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        made_up_site(11, tmp_path / folder, laps=1, duration_s=20.0)
    first = {path.relative_to(tmp_path / "first"): path for path in (tmp_path / "first").rglob("*.*")}
    assert len(first) == 6
    for name, path in first.items():
        assert path.read_bytes() == (tmp_path / "second" / name).read_bytes()


def test_two_buildings_share_a_folder(tmp_path: Path) -> None:
    paths = [made_up_site(seed, tmp_path, laps=1, duration_s=10.0) for seed in (1, 2)]
    for path, seed in zip(paths, (1, 2), strict=True):
        spec = load_spec(path)
        files = [spec.locate(file, None) for file in (*spec.files, *spec.sheets)]
        assert all(file.is_file() and (tmp_path / spec.site.name) in file.parents for file in files)
        assert spec.site == make_building(seed).site


def test_walls_between_against_known_geometry() -> None:
    building = make_building(7)
    x0, y0, x1, y1 = building.walls_m[0]
    middle = (x0 + x1) / 2
    inside = walls_between(building, np.array([[middle, y0 - 1]]), np.array([[middle, y1 + 1]]))
    assert inside[0, 0] == pytest.approx(y1 - y0)
    beside = walls_between(building, np.array([[x0, y0 - 1]]), np.array([[x1, y0 - 1]]))
    assert beside.sum() == 0.0


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("device", [1, 2])
def test_walks_stay_clear_of_walls_at_the_speed_of_the_robot(seed: int, device: int) -> None:
    building = make_building(seed)
    recording = walk(building, device=device, lap=1, duration_s=400.0)
    nothing = np.zeros(2)
    moved = walls_between(building, recording.position_m[:-1], recording.position_m[1:])
    assert moved.sum() == 0.0
    assert walls_between(building, recording.position_m[:1], recording.position_m[:1] + nothing).sum() == 0
    steps = np.linalg.norm(np.diff(recording.position_m, axis=0), axis=1)
    seconds = np.diff(recording.t_s)
    assert ((seconds >= 0.2) & (seconds <= 0.5)).all()
    assert 0.1 <= np.median(steps / seconds) <= 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_errors_are_those_asked_for(seed: int) -> None:
    building = make_building(seed)
    recordings = [
        walk(building, device=device, lap=lap, duration_s=600.0) for device in (1, 2) for lap in (1, 2)
    ]
    errors = np.concatenate([range_errors(building, recording) for recording in recordings])
    walls = np.concatenate([recording.walls for recording in recordings])
    heard = np.isfinite(errors)
    clear, blocked = errors[heard & (walls == 0)], errors[heard & (walls >= 2)]
    assert np.median(clear) == pytest.approx(LINE_OF_SIGHT_OFFSET_M, abs=0.15)
    assert 0.1 < clear.std() < 0.5
    assert np.median(blocked) > np.median(clear) + 0.5
    centred = blocked - blocked.mean()
    assert (centred**3).mean() / blocked.std() ** 3 > 0.5
    assert blocked.mean() > np.median(blocked)

    strength = np.concatenate([recording.rss_dbm for recording in recordings])
    assert np.median(strength[walls == 0]) > np.median(strength[walls >= 3]) + 8
    answered = np.concatenate([recording.heard for recording in recordings])
    assert 0.4 < answered.mean() < 0.97
    far = np.concatenate([recording.range_m for recording in recordings]) > 100.0
    assert 0.0005 < far.mean() < 0.004


def test_excess_changes_over_a_metre_not_over_a_reading() -> None:
    building = make_building(7)
    recording = walk(building, device=1, lap=1, duration_s=600.0)
    excess = np.where(recording.walls >= 2, range_errors(building, recording), np.nan)
    pairs = np.stack([excess[:-1], excess[1:]])[:, np.isfinite(excess[:-1]) & np.isfinite(excess[1:])]
    assert np.corrcoef(pairs)[0, 1] > 0.7


def test_plan_shows_the_walls_that_the_ranges_met(spec: SiteSpec) -> None:
    building, plan = make_building(7), plan_of(spec)
    recording = walk(building, device=2, lap=1, duration_s=200.0)
    starts, ends = links(building, recording)
    analytic = walls_between(building, starts, ends)
    drawn = wall_crossings(plan, starts, ends)
    assert ((drawn.count == 0) == (recording.walls.ravel() == 0)).mean() > 0.99
    assert np.corrcoef(drawn.thickness_m, analytic.sum(axis=1))[0, 1] > 0.98
    assert line_of_sight(plan, starts, ends).mean() == pytest.approx(
        (analytic.sum(axis=1) == 0).mean(), abs=0.01
    )


def test_phones_walk_where_the_plan_is_free(spec: SiteSpec) -> None:
    building, plan = make_building(7), plan_of(spec)
    cells = free_space(plan, spec.site.positions_m)
    for device in (1, 2):
        places = walk(building, device=device, lap=1, duration_s=300.0).position_m
        column, row = np.round(plan.georeference.to_pixels(places)).astype(int).T
        assert cells[row, column].all()
    # Nothing outside the outer walls, and no stair well without a door.
    outside = plan.georeference.to_pixels([[building.outline_m[0] - 1, building.outline_m[1] - 1]])
    stairs = plan.georeference.to_pixels([np.reshape(building.stairs_m, (2, 2)).mean(axis=0)])
    for column, row in np.round(np.concatenate([outside, stairs])).astype(int):
        assert not cells[row, column]


def test_the_parsers_of_real_files_read_it(spec: SiteSpec) -> None:
    building = make_building(7)
    assert spec.site == building.site
    assert [(recording.device, recording.name, recording.split) for recording in spec.recordings] == [
        (1, "113", "train"), (1, "213", "test"), (2, "124", "train"), (2, "224", "test"),
    ]  # fmt: skip
    first = spec.recordings[0]
    assert first.raw is not None
    lap = read_phone_log(spec.locate(first.raw, None), spec.site)
    truth = walk(building, device=1, lap=1, duration_s=60.0)
    answered = truth.heard.any(axis=1)
    assert len(lap.sets) == answered.sum()
    np.testing.assert_allclose(
        lap.sets["t_ms"], (truth.t_s[answered] - truth.t_s[answered][0]) * 1000, atol=0.01
    )
    np.testing.assert_allclose(lap.sets[["x_m", "y_m"]], truth.position_m[answered], atol=1e-3)
    assert len(lap.readings) == truth.heard.sum()

    link = read_device_link(spec.locate(spec.links[0].file, None))
    assert 50 < len(link) < 120
    sheet = read_ap_sheet(spec.locate(spec.sheets[0], None))
    np.testing.assert_allclose(list(sheet.access_points.values()), spec.site.positions_m)


def test_it_builds_like_a_real_site(spec: SiteSpec, tmp_path: Path) -> None:
    (report,) = build_sites(None, tmp_path, [spec.path])
    packed = read_packed(tmp_path, "made-up-7")
    assert packed.site.made_up
    assert report is not None
    recordings = packed.recordings()
    assert [(recording.device, recording.name) for recording in recordings] == [
        (1, "113"), (1, "213"), (2, "124"), (2, "224"),
    ]  # fmt: skip
    truth = walk(make_building(7), device=2, lap=2, duration_s=60.0)
    rebuilt = recordings[3]
    near = truth.heard & (truth.range_m < 100)
    assert rebuilt.heard.sum() == near[truth.heard.any(axis=1)].sum()
    np.testing.assert_allclose(rebuilt.slant_m[rebuilt.heard], truth.range_m[near], atol=6e-4)


def test_phones_measure_one_another() -> None:
    building = make_building(7)
    one, two = (walk(building, device=device, lap=1, duration_s=600.0) for device in (1, 2))
    text = link_log(building, one, two, np.random.default_rng(0))
    time_ms, ranges, spread, strength = np.array(
        [line.split(",") for line in text.splitlines()[1:]], dtype=float
    ).T
    truth = [
        np.column_stack([np.interp(time_ms / 1000, lap.t_s, lap.position_m[:, axis]) for axis in (0, 1)])
        for lap in (one, two)
    ]
    clear = walls_between(building, *truth).sum(axis=1) == 0
    errors = ranges - np.linalg.norm(truth[1] - truth[0], axis=1)
    assert np.median(errors[clear]) == pytest.approx(LINK_OFFSET_M, abs=0.2)
    assert np.median(errors[~clear]) > np.median(errors[clear])
    assert (spread > 0).all()
    assert ((strength >= -90) & (strength <= -30)).all()
