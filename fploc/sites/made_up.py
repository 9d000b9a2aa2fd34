"""Made-up buildings: seeded rooms, walls, access points and walks, written as the phone's own files.

Nothing of it was measured. Ranges and signal strengths err as those of the public data do: an offset in
line of sight, an excess for every wall on the way that is skewed to the right and changes over about a
metre, outliers, dropouts. One seed gives the same bytes on every run.

Axes: T reading sets of a recording, A access points, N walls, L links.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import gammaincinv, ndtr

from fploc.errors import FplocError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import Grey, write_grey_image
from fploc.sites.site import AccessPoint, Site

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Material:
    """What a wall is made of.

    Args:
        name: For example ``brick``.
        thickness_m: Thickness of a wall of it.
        shade: Grey value that it is drawn with, 0 black.
        excess_m: Mean length that one wall, crossed at a right angle, adds to an RTT range.
        loss_db: What one wall takes from the signal strength.
    """

    name: str
    thickness_m: float
    shade: int
    excess_m: float
    loss_db: float


# Drawn as in the public plans: structure black, partitions grey, glass a hairline.
MATERIALS = (
    Material("concrete", thickness_m=0.30, shade=0, excess_m=1.60, loss_db=9.0),
    Material("brick", thickness_m=0.20, shade=0, excess_m=0.90, loss_db=6.0),
    Material("plasterboard", thickness_m=0.14, shade=128, excess_m=0.50, loss_db=3.0),
    Material("glass", thickness_m=0.04, shade=0, excess_m=0.30, loss_db=2.0),
)
CONCRETE, BRICK, PLASTERBOARD, GLASS = range(len(MATERIALS))

# Statistics of the public data (office with repaired labels; link bias: the mall).
LINE_OF_SIGHT_OFFSET_M = 0.94
LINK_OFFSET_M = 2.4
_OFFSET_SPREAD_M = 0.08
_RANGE_SPREAD_M = (0.1, 0.5)
_EXCESS_SHAPE = 2.0
_CORRELATION_M = 1.0
_RSS_SPREAD_DB = 4.0
_RSS_AT_1M_DBM = -40.0
_PATH_LOSS_EXPONENT = 1.9
_WEAKEST_DBM = -90.0
_DROPOUT_SHARE = 0.04
_DROPOUT_LENGTH = 8.0
_OUTLIER_SHARE = 1.5e-3
_LOG_OUTLIER = (float(np.log(100.0)), float(np.log(56_000.0)))  # metres
_INTERVAL_S = (0.22, 0.5)
_IMU_STEP_S = 0.1
_SPEED_MPS = (0.15, 0.45)

_NATIVE_PIXELS_PER_METRE = 32
_METRES_PER_PIXEL = 0.05
_PLAN_MARGIN_M = 2.0
_DEVICE_HEIGHT_M = 1.0
_DOOR_M = 1.1
_LARGEST_SEED = 2**24 - 1
_PLAN_FILE = "floor_plan.png"
_FIRST_DAY = datetime(2030, 1, 1, 10, tzinfo=UTC)

# Device → how its recordings and log files are called, as by the authors' loggers.
_RECORDING_SUFFIX = {1: "13", 2: "24"}
_LOG_PREFIX = {1: "1_3", 2: "2_4"}


@dataclass(frozen=True, eq=False)
class MadeUpBuilding:
    """The geometry of a made-up building, metres, site frame.

    Args:
        seed: What it was drawn from.
        site: Its access points, marked as made up.
        walls_m: Rectangles x0, y0, x1, y1, shape (N, 4).
        materials: Index into ``MATERIALS``, shape (N,).
        stairs_m: Rectangle x0, y0, x1, y1 of a stair whose treads are drawn and are no walls.
        outline_m: Rectangle x0, y0, x1, y1 of the building.
        walks_m: Device → corners of a closed walk through corridors and doors, shape (K, 2).
    """

    seed: int
    site: Site
    walls_m: Floats
    materials: Ints
    stairs_m: tuple[float, float, float, float]
    outline_m: tuple[float, float, float, float]
    walks_m: dict[int, Floats]

    @property
    def plan_origin_m(self) -> tuple[float, float]:
        """Outer corner of the plan's top-left pixel, metres."""
        return self.outline_m[0] - _PLAN_MARGIN_M, self.outline_m[3] + _PLAN_MARGIN_M

    @property
    def plan_extent_m(self) -> tuple[float, float]:
        """Width and height of the plan, metres."""
        x0, y0, x1, y1 = self.outline_m
        return x1 - x0 + 2 * _PLAN_MARGIN_M, y1 - y0 + 2 * _PLAN_MARGIN_M


@dataclass(frozen=True, eq=False)
class MadeUpRecording:
    """One lap of one phone through a made-up building, before it is written down.

    Args:
        t_s: Time of each reading set, shape (T,), seconds from the start of the lap.
        position_m: True position, shape (T, 2), metres, site frame.
        range_m: RTT range in space, shape (T, A), metres.
        std_m: The phone's own spread, shape (T, A), metres.
        rss_dbm: Shape (T, A), dBm.
        heard: True where the access point answered, shape (T, A).
        walls: Walls on the straight line to each access point, shape (T, A).
    """

    t_s: Floats
    position_m: Floats
    range_m: Floats
    std_m: Floats
    rss_dbm: Floats
    heard: Bools
    walls: Ints


def make_building(seed: int) -> MadeUpBuilding:
    """Draw a building: a ring of corridors round a core, rooms outside it, 6 to 8 access points.

    Raises:
        FplocError: If the seed is not from 0 to 16777215.
    """
    if not 0 <= seed <= _LARGEST_SEED:
        raise FplocError(
            "seed of a made-up building",
            value=seed,
            expected=f"a whole number from 0 to {_LARGEST_SEED}",
            way_out="give another --seed",
        )
    rng = np.random.default_rng([seed, 0])
    draft = _Draft(rng)
    origin = np.round(rng.uniform([-15.0, -8.0], [5.0, 8.0]), 1)
    shift = np.tile(origin, 2)
    stairs, outline = draft.stairs + shift, draft.outline + shift
    name = f"made-up-{seed}"
    return MadeUpBuilding(
        seed=seed,
        site=Site(
            name=name,
            place=name,
            access_points=_access_points(seed, np.round(draft.access_points(rng) + origin, 3), rng),
            device_height_m=_DEVICE_HEIGHT_M,
            made_up=True,
        ),
        walls_m=np.array(draft.rectangles) + shift,
        materials=np.array(draft.materials, dtype=np.int64),
        stairs_m=(stairs[0], stairs[1], stairs[2], stairs[3]),
        outline_m=(outline[0], outline[1], outline[2], outline[3]),
        walks_m={device: draft.walk(rng, device) + origin for device in _RECORDING_SUFFIX},
    )


def walls_between(building: MadeUpBuilding, starts_m: Floats, ends_m: Floats) -> Floats:
    """Return the length of each link inside each wall, shape (L, N), metres.

    Args:
        building: The building.
        starts_m: Shape (L, 2), metres, site frame.
        ends_m: Shape (L, 2), metres, site frame.
    """
    along = (ends_m - starts_m)[:, None]
    # A link along an axis is treated as turned by a hair: no division by zero.
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)
    low, high = building.walls_m[:, :2], building.walls_m[:, 2:]
    first, second = (low - starts_m[:, None]) / along, (high - starts_m[:, None]) / along
    enter = np.minimum(first, second).max(axis=-1).clip(0.0, 1.0)
    leave = np.maximum(first, second).min(axis=-1).clip(0.0, 1.0)
    lengths: Floats = np.maximum(leave - enter, 0.0) * np.linalg.norm(ends_m - starts_m, axis=1)[:, None]
    return lengths


def walk(building: MadeUpBuilding, *, device: int, lap: int, duration_s: float) -> MadeUpRecording:
    """Walk a phone along its closed path and let it measure.

    Args:
        building: The building.
        device: 1 or 2.
        lap: 1 or more; each has its own speed and noise, and the same path.
        duration_s: The phone goes round its path for so long.
    """
    rng = np.random.default_rng([building.seed, 1, lap, device])
    speed = rng.uniform(*_SPEED_MPS)
    t_s = np.cumsum(rng.uniform(*_INTERVAL_S, size=round(duration_s / np.mean(_INTERVAL_S))))
    t_s -= t_s[0]
    step_s = np.diff(t_s, prepend=0.0)
    memory = np.exp(-speed * np.mean(_INTERVAL_S) / _CORRELATION_M)
    pace = speed * (1.0 + 0.15 * np.tanh(_correlated(rng, (len(t_s),), memory)))
    position = _along(building.walks_m[device], np.cumsum(pace * step_s))
    return _measure(building, rng, t_s, position, memory)


def write_building(building: MadeUpBuilding, out: Path) -> None:
    """Write the plan image and the access point sheet of a building into ``out/<name>/``."""
    folder = out / building.site.name
    folder.mkdir(parents=True, exist_ok=True)
    write_grey_image(folder / _PLAN_FILE, _draw(building))
    sheet = pd.DataFrame(
        building.site.positions_m, index=[ap.name for ap in building.site.access_points], columns=["x", "y"]
    )
    # The authors' sheets begin with a byte order mark.
    _write_text(folder / f"AP_idx_{building.site.name}.csv", "\ufeff" + sheet.to_csv(lineterminator="\n"))


def made_up_site(seed: int, out: Path, laps: int = 3, duration_s: float = 300.0) -> Path:
    """Write a made-up building and its recordings as the files of a site, and return its site file.

    The files go to ``out/<name>/``, the site file to ``out/<name>.yaml``. It comes last: where it stands,
    everything it names is complete.

    Args:
        seed: One seed gives the same bytes.
        out: Folder to write into; made where it is missing.
        laps: Laps of each of the two phones, recorded at the same time.
        duration_s: Length of each lap, seconds.

    Raises:
        FplocError: If the seed, the number of laps or the duration is out of range.
    """
    for option, value, least in (("laps", laps, 1), ("duration_s", duration_s, 10.0)):
        if not value >= least:
            raise FplocError(
                f"{option} of a made-up building",
                value=value,
                expected=f"a number of at least {least}",
                way_out="give a larger one",
            )
    building = make_building(seed)
    name = building.site.name
    write_building(building, out)
    recordings: list[dict[str, Any]] = []
    links: list[dict[str, Any]] = []
    for lap in range(1, laps + 1):
        began = _FIRST_DAY + timedelta(seconds=round((lap - 1) * (duration_s + 120.0)))
        (out / name / str(lap)).mkdir(exist_ok=True)
        walked = {
            device: walk(building, device=device, lap=lap, duration_s=duration_s) for device in _LOG_PREFIX
        }
        for device, recording in walked.items():
            file = f"{name}/{lap}/{_LOG_PREFIX[device]}_{began:%H_%M_%S}.csv"
            rng = np.random.default_rng([building.seed, 2, lap, device])
            log = phone_log(building.site, recording, rng)
            _write_text(out / file, log)
            recordings.append(
                {
                    "device": device,
                    "name": f"{lap}{_RECORDING_SUFFIX[device]}",
                    "lap": str(lap),
                    "split": _split(lap, laps),
                    "raw": {"path": file},
                }
            )
        file = f"{name}/{lap}/rtt-log-{began:%b-%d-%Y-%I-%M-%S-%p}.csv"
        rng = np.random.default_rng([building.seed, 3, lap])
        _write_text(out / file, link_log(building, walked[1], walked[2], rng))
        links.append({"lap": str(lap), "clock": "starts with both devices (made up)", "file": {"path": file}})
    recordings.sort(key=lambda entry: (entry["device"], int(entry["lap"])))
    path = out / f"{name}.yaml"
    _write_text(path, _site_file(building, recordings, links))
    return path


def phone_log(site: Site, recording: MadeUpRecording, rng: np.random.Generator) -> str:
    """Return a recording as the text of the phone logger's CSV file.

    A reading set stands on its own row and again on every IMU row until the next set. Ranges are
    millimetres, times nanoseconds since the phone started; the last two columns are the true x and y in
    metres, under the heading ``Points,,`` as in the laboratory's logs.
    """
    sets = np.flatnonzero(recording.heard.any(axis=1))
    set_time = recording.t_s[sets]
    until_next = np.diff(set_time, append=set_time[-1] + _IMU_STEP_S)
    repeats = np.maximum(np.ceil(until_next / _IMU_STEP_S - 1e-9).astype(np.int64), 1)
    repeats = np.minimum(repeats, 6)
    of_set = np.repeat(np.arange(len(sets)), repeats)
    within = np.arange(len(of_set)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    row_time = set_time[of_set] + within * _IMU_STEP_S
    position = _interpolated(row_time, recording.t_s, recording.position_m)
    start_ns = int(rng.integers(10**12, 10**13))
    frame = pd.DataFrame({"Number": np.arange(len(of_set))})
    frame["RTT_TIMESTAMP"] = start_ns + np.round(set_time[of_set] * 1e9).astype(np.int64)
    frame["RTT_RESULT"] = _rtt_results(site, recording, sets)[of_set]
    frame["IMU_TIMESTAMP"] = start_ns + np.round(row_time * 1e9).astype(np.int64)
    frame = pd.concat([frame, _imu(row_time, position, rng)], axis=1)
    # The logger's button for marking points was never pressed: 0 throughout.
    frame["Points"] = 0
    frame["x"], frame["y"] = np.round(position, 4).T
    header = ",".join([*frame.columns[:-2], "", ""])
    return header + "\n" + frame.to_csv(index=False, header=False, lineterminator="\n")


def link_log(
    building: MadeUpBuilding, first: MadeUpRecording, second: MadeUpRecording, rng: np.random.Generator
) -> str:
    """Return what phone 1 measured of its distance from phone 2 as the text of the logger's CSV file."""
    end = min(first.t_s[-1], second.t_s[-1])
    t_s = np.cumsum(rng.uniform(0.5, 1.1, size=max(2, int(end / 1.1))))
    t_s -= t_s[0]
    ends = [_interpolated(t_s, device.t_s, device.position_m) for device in (first, second)]
    distance = np.linalg.norm(ends[1] - ends[0], axis=1)
    crossed = _crossings(building, walls_between(building, ends[0], ends[1]))
    spread = rng.uniform(*_RANGE_SPREAD_M, size=len(t_s))
    skew = rng.gamma(_EXCESS_SHAPE, 1.0 / _EXCESS_SHAPE, size=len(t_s))
    ranges = distance + LINK_OFFSET_M + skew * (crossed @ _column("excess_m")) + rng.normal(0.0, spread)
    rss = _path_loss(distance) - crossed @ _column("loss_db") + rng.normal(0.0, _RSS_SPREAD_DB, len(t_s))
    frame = pd.DataFrame(
        {
            "Time Stamp (ms)": np.round(t_s * 1000).astype(np.int64),
            "M1-M2 RTT Distance (m)": np.round(np.maximum(ranges, 0.05), 3),
            "RTT std (m)": np.round(spread, 3),
            "RSS (dBm)": np.round(rss.clip(_WEAKEST_DBM, -30.0)).astype(np.int64),
        }
    )
    return frame.to_csv(index=False, lineterminator="\n")


class _Draft:
    """Walls, doors and rooms while they are drawn; lower left corner of the building at (0, 0)."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rectangles: list[tuple[float, float, float, float]] = []
        self.materials: list[int] = []
        self._doors: list[tuple[float, float, int, float]] = []
        width, core = rng.uniform(26.0, 36.0), rng.uniform(4.0, 6.0)
        self._corridor = rng.uniform(2.4, 3.0)
        lower, upper = rng.uniform(4.5, 6.0, size=2)
        height = lower + upper + core + 2 * self._corridor
        self.outline = np.array([0.0, 0.0, width, height])
        self._levels = (lower, lower + self._corridor, height - upper - self._corridor, height - upper)
        for y in (0.0, height):
            self._wall(CONCRETE, 0.0, y, width, y)
        for x in (0.0, width):
            self._wall(CONCRETE, x, 0.0, x, height)
        self._centres = [
            *self._row(rng, 0.0, width, 0.0, lower, door_y=lower, into=-1),
            *self._row(rng, 0.0, width, height - upper, height, door_y=height - upper, into=1),
        ]
        self.stairs = self._core(rng, width)

    def access_points(self, rng: np.random.Generator) -> Floats:
        """Choose 6 to 8 places in rooms and corridors that lie far from one another, shape (A, 2)."""
        low, high = self._levels[0] + 0.4, self._levels[3] - 0.4
        width = self.outline[2]
        across = np.linspace(0.15, 0.85, 6) * width
        corridors = [(x + rng.uniform(-1, 1), y) for x in across for y in (low, high)]
        middle = (low + high) / 2
        candidates = np.array([*corridors, (0.5, middle), (width - 0.5, middle), *self._centres])
        chosen = [int(rng.integers(len(candidates)))]
        for _ in range(int(rng.integers(5, 8))):
            apart = np.linalg.norm(candidates[:, None] - candidates[chosen], axis=-1).min(axis=1)
            chosen.append(int(np.argmax(apart * rng.uniform(0.8, 1.0, size=len(apart)))))
        return candidates[chosen]

    def walk(self, rng: np.random.Generator, device: int) -> Floats:
        """Return a closed walk round the ring with visits through some doors, shape (K, 2)."""
        side = 0.35 * (-1 if device == 1 else 1)
        lower = (self._levels[0] + self._levels[1]) / 2 - side
        upper = (self._levels[2] + self._levels[3]) / 2 + side
        left = self._corridor / 2 - side
        right = self.outline[2] - left
        corners: list[tuple[float, float]] = []
        for y, into, ahead in ((lower, -1, True), (upper, 1, False)):
            corners.append((left if ahead else right, y))
            doors = [door for door in self._doors if door[2] == into and left < door[0] < right]
            visited = sorted(rng.permutation(len(doors))[:2], key=lambda i: doors[i][0], reverse=not ahead)
            for x, door_y, _, depth in (doors[index] for index in visited):
                corners += [(x, y), (x, door_y + into * 0.55 * depth), (x, y)]
            corners.append((right if ahead else left, y))
        path = np.array(corners)
        return path if device == 1 else path[::-1].copy()

    def _row(
        self,
        rng: np.random.Generator,
        x0: float,
        x1: float,
        y0: float,
        y1: float,
        *,
        door_y: float,
        into: int,
    ) -> list[tuple[float, float]]:
        """Draw rooms side by side with one door each to the corridor; return a place in each."""
        count = max(2, int((x1 - x0) / rng.uniform(4.0, 6.0)))
        cuts = np.linspace(x0, x1, count + 1)
        cuts[1:-1] += rng.uniform(-0.6, 0.6, size=count - 1)
        for x in cuts[1:-1]:
            self._wall(int(rng.choice([BRICK, PLASTERBOARD])), x, y0, x, y1)
        places = []
        for left, right in pairwise(cuts):
            material = int(rng.choice([BRICK, PLASTERBOARD, GLASS]))
            door = rng.uniform(left + 1.0, right - 1.0)
            self._wall(material, left, door_y, door - _DOOR_M / 2, door_y)
            self._wall(material, door + _DOOR_M / 2, door_y, right, door_y)
            self._doors.append((door, door_y, into, y1 - y0))
            places.append((rng.uniform(left + 0.6, right - 0.6), y1 - 0.5 if into > 0 else y0 + 0.5))
        return places

    def _core(self, rng: np.random.Generator, width: float) -> Floats:
        """Draw the block inside the ring: a stair well of concrete and rooms; return the stair's rectangle."""
        y0, y1 = self._levels[1], self._levels[2]
        x0, x1 = self._corridor, width - self._corridor
        well = x0 + 3.0
        for y in (y0, y1):
            self._wall(CONCRETE, x0, y, well, y)
        for x in (x0, well):
            self._wall(CONCRETE, x, y0, x, y1)
        self._row(rng, well, x1, y0, y1, door_y=y1, into=0)
        self._wall(BRICK, well, y0, x1, y0)
        self._wall(BRICK, x1, y0, x1, y1)
        return np.array([x0 + 0.5, y0 + 0.5, well - 0.5, y1 - 0.5])

    def _wall(self, material: int, x0: float, y0: float, x1: float, y1: float) -> None:
        """Add a wall along an axis, its thickness around the line and its ends closing the corners."""
        half = MATERIALS[material].thickness_m / 2
        across = (0.0, half) if y0 == y1 else (half, 0.0)
        self.rectangles.append((x0 - across[0], y0 - across[1], x1 + across[0], y1 + across[1]))
        self.materials.append(material)


def _access_points(seed: int, positions: Floats, rng: np.random.Generator) -> tuple[AccessPoint, ...]:
    # The second lowest bit of the first byte says 'locally administered': no maker owns such an address.
    prefix = ":".join(f"{byte:02x}" for byte in (2, *seed.to_bytes(3, "big"), 0))
    heights = np.round(rng.uniform(1.5, 2.6, size=len(positions)), 2)
    return tuple(
        AccessPoint(
            name=f"AP{number}",
            mac=f"{prefix}:{number:02x}",
            x_m=float(x),
            y_m=float(y),
            height_m=float(height),
        )
        for number, ((x, y), height) in enumerate(zip(positions, heights, strict=True), start=1)
    )


def _along(corners: Floats, travelled_m: Floats) -> Floats:
    """Return the places reached on a closed path after the given lengths, shape (T, 2)."""
    closed = np.vstack([corners, corners[:1]])
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    return _interpolated(travelled_m % reached[-1], reached, closed)


def _interpolated(at: Floats, knots: Floats, points: Floats) -> Floats:
    return np.column_stack([np.interp(at, knots, points[:, axis]) for axis in (0, 1)])


def _correlated(rng: np.random.Generator, shape: tuple[int, ...], memory: float) -> Floats:
    """Return standard normal numbers that change slowly along the first axis (AR(1))."""
    noise = rng.standard_normal(shape)
    noise[1:] *= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise, axis=0), dtype=np.float64)


def _column(name: str) -> Floats:
    return np.array([getattr(material, name) for material in MATERIALS])


def _crossings(building: MadeUpBuilding, inside_m: Floats) -> Floats:
    """Return how many walls of each material a link crosses, shape (L, len(MATERIALS)).

    A wall crossed aslant counts for as much more as the way through it is longer, at most twice; a corner
    that is only cut counts in part.
    """
    share = (inside_m / _column("thickness_m")[building.materials]).clip(0.0, 2.0)
    of_material = building.materials[:, None] == np.arange(len(MATERIALS))
    counts: Floats = share @ of_material.astype(np.float64)
    return counts


def _path_loss(distance_m: Floats) -> Floats:
    return _RSS_AT_1M_DBM - 10 * _PATH_LOSS_EXPONENT * np.log10(np.maximum(distance_m, 0.3))


def _measure(
    building: MadeUpBuilding, rng: np.random.Generator, t_s: Floats, position: Floats, memory: float
) -> MadeUpRecording:
    site = building.site
    shape = (len(t_s), len(site.access_points))
    flat = np.linalg.norm(position[:, None] - site.positions_m, axis=-1)
    slant = np.hypot(flat, site.height_differences_m)
    starts = np.broadcast_to(site.positions_m, (*shape, 2)).reshape(-1, 2)
    inside = walls_between(building, starts, np.repeat(position, shape[1], axis=0))
    crossed = _crossings(building, inside)
    # Of the access point, not of the lap: the same in every recording of a building.
    offset = LINE_OF_SIGHT_OFFSET_M + _OFFSET_SPREAD_M * np.random.default_rng(
        [building.seed, 4]
    ).standard_normal(shape[1])
    spread = np.random.default_rng([building.seed, 5]).uniform(*_RANGE_SPREAD_M, size=shape[1])

    skew = gammaincinv(_EXCESS_SHAPE, ndtr(_correlated(rng, shape, memory))) / _EXCESS_SHAPE
    excess = (crossed @ _column("excess_m")).reshape(shape) * skew
    ranges = slant + offset + excess + rng.normal(0.0, spread, size=shape)
    outlier = rng.random(shape) < _OUTLIER_SHARE
    ranges = np.where(outlier, np.exp(rng.uniform(*_LOG_OUTLIER, size=shape)), ranges)

    shadow = _RSS_SPREAD_DB * (0.8 * _correlated(rng, shape, memory) + 0.6 * rng.standard_normal(shape))
    rss = _path_loss(slant) - (crossed @ _column("loss_db")).reshape(shape) + shadow
    silent = _correlated(rng, shape, 1.0 - 1.0 / _DROPOUT_LENGTH)
    heard = (ndtr(silent) > _DROPOUT_SHARE) & (rss > _WEAKEST_DBM)
    return MadeUpRecording(
        t_s=t_s,
        position_m=position,
        range_m=np.maximum(ranges, 0.01),
        std_m=spread * rng.gamma(4.0, 0.25, size=shape),
        rss_dbm=np.minimum(rss, -25.0),
        heard=heard,
        walls=(inside > 0).sum(axis=1).reshape(shape),
    )


def _rtt_results(site: Site, recording: MadeUpRecording, sets: Ints) -> NDArray[np.object_]:
    """Return the logger's text for each reading set: "[MAC, mm, std mm, RSS, MAC, …]"."""
    row, access_point = np.nonzero(recording.heard[sets])
    cell = (sets[row], access_point)
    long = pd.DataFrame(
        {
            "row": row,
            "mac": np.array(site.macs)[access_point],
            "range": np.round(recording.range_m[cell] * 1000).astype(np.int64).astype(str),
            "std": np.round(recording.std_m[cell] * 1000).astype(np.int64).astype(str),
            "rss": np.round(recording.rss_dbm[cell]).astype(np.int64).astype(str),
        }
    )
    entries = long["mac"] + ", " + long["range"] + ", " + long["std"] + ", " + long["rss"]
    texts = "[" + entries.groupby(long["row"]).agg(", ".join) + "]"
    return texts.to_numpy(dtype=np.object_)


def _imu(t_s: Floats, position: Floats, rng: np.random.Generator) -> pd.DataFrame:
    """Return what the phone's other sensors say on each row: at rest but for turns, and noisy."""
    moved = np.gradient(position, axis=0)
    heading = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    turn = np.gradient(heading, np.maximum(np.arange(len(t_s)) * _IMU_STEP_S, t_s))
    rows = len(t_s)
    columns = {
        "Accx": rng.normal(0.0, 0.3, rows),
        "Accy": rng.normal(0.0, 0.3, rows),
        "Accz": rng.normal(9.81, 0.3, rows),
        "Gyrox": rng.normal(0.0, 0.03, rows),
        "Gyroy": rng.normal(0.0, 0.03, rows),
        "Gyroz": turn.clip(-3.0, 3.0) + rng.normal(0.0, 0.03, rows),
        "Magx": 20.0 * np.cos(heading) + rng.normal(0.0, 0.5, rows),
        "Magy": -20.0 * np.sin(heading) + rng.normal(0.0, 0.5, rows),
        "Magz": rng.normal(-40.0, 0.5, rows),
        "Azimuth": np.angle(np.exp(1j * (np.pi / 2 - heading))),
        "Pitch": rng.normal(0.0, 0.03, rows),
        "Roll": rng.normal(0.0, 0.03, rows),
    }
    return pd.DataFrame({name: np.round(values, 6) for name, values in columns.items()})


def _draw(building: MadeUpBuilding) -> Grey:
    """Return the plan as an architect's image, 255 free."""
    width, height = (round(extent * _NATIVE_PIXELS_PER_METRE) for extent in building.plan_extent_m)
    image = np.full((height, width), 255, dtype=np.uint8)
    native = Georeference.of_raster(building.plan_origin_m, 1.0 / _NATIVE_PIXELS_PER_METRE)
    # Light first: where walls meet, the darker one is seen.
    order = np.argsort([-MATERIALS[material].shade for material in building.materials], kind="stable")
    for wall in order:
        _fill(image, native, building.walls_m[wall], MATERIALS[building.materials[wall]].shade)
    x0, y0, x1, y1 = building.stairs_m
    for y in np.arange(y0, y1, 0.3):
        _fill(image, native, np.array([x0, y, x1, y + 0.03]), 0)
    return image


def _fill(image: Grey, native: Georeference, rectangle_m: Floats, shade: int) -> None:
    (left, bottom), (right, top) = native.to_pixels(rectangle_m.reshape(2, 2)) + 0.5
    columns = slice(round(left), max(round(right), round(left) + 1))
    rows = slice(round(top), max(round(bottom), round(top) + 1))
    image[rows, columns] = shade


def _split(lap: int, laps: int) -> str:
    if lap == laps:
        return "test"
    return "validate" if lap == laps - 1 and laps > 2 else "train"


def _site_file(
    building: MadeUpBuilding, recordings: list[dict[str, Any]], links: list[dict[str, Any]]
) -> str:
    native = Georeference.of_raster(building.plan_origin_m, 1.0 / _NATIVE_PIXELS_PER_METRE)
    x0, y0, x1, y1 = (float(edge) for edge in building.stairs_m)
    x0, y0, x1, y1 = x0 - 0.1, y0 - 0.1, x1 + 0.1, y1 + 0.1
    site = building.site
    document = {
        "name": site.name,
        "description": f"A made-up building drawn from seed {building.seed}: nothing of it was measured.",
        "place": site.place,
        "made_up": True,
        "device_height_m": site.device_height_m,
        "numbering": "names",
        "access_points_origin": "made up",
        "access_points": [
            {"name": ap.name, "mac": ap.mac, "x_m": ap.x_m, "y_m": ap.y_m, "height_m": ap.height_m}
            for ap in site.access_points
        ],
        "plan": {
            "file": {"path": f"{site.name}/{_PLAN_FILE}"},
            "native_from_metres": native.pixels_from_metres.tolist(),
            "origin_m": [float(coordinate) for coordinate in building.plan_origin_m],
            "size_px": [int(np.ceil(extent / _METRES_PER_PIXEL)) for extent in building.plan_extent_m],
            "metres_per_pixel": _METRES_PER_PIXEL,
            "estimated_error_m": 0.0,
            "notes": "Drawn from the same geometry as the measurements.",
            "not_walls_m": [[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]],
            "blank_boxes_px": [],
        },
        "recordings": recordings,
        "links": links,
        "sheets": [{"path": f"{site.name}/AP_idx_{site.name}.csv"}],
    }
    heading = f"# Made by `fploc made-up --seed {building.seed}`: no real building, no measurement.\n"
    return heading + yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=110)


def _write_text(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.partial")
    try:
        temporary.write_text(text, encoding="utf-8", newline="")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
