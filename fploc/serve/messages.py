"""The wire schema, version 1: what phones send and what the server answers. Units stand in the names.

Everything that comes from outside is checked here: kinds, bounds, lengths, no NaN and no infinity, no field that
is not known.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

VERSION: Final = 1
MOST_INTERVALS = 1000
MOST_READINGS = 64
MOST_LINKS = 64
LATEST_MS = 1e14

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", max_length=64)]
Bssid = Annotated[str, Field(pattern=r"^[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}$", max_length=17)]
RangeM = Annotated[float, Field(ge=-10.0, le=1000.0)]
SpreadM = Annotated[float, Field(ge=0.0, le=1000.0)]
RssDbm = Annotated[float, Field(ge=-150.0, le=50.0)]
PlaceM = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, strict=True)


class Reading(_Message):
    """One access point in a reading set; a range may miss, and one at or below 0 m counts as missing."""

    bssid: Bssid
    range_m: RangeM | None = None
    range_std_m: SpreadM | None = None
    rss_dbm: RssDbm | None = None


class Link(_Message):
    """What was measured to another device. It is checked and counted; no position depends on it (docs/phone.md)."""

    device: Name
    range_m: RangeM
    range_std_m: SpreadM | None = None
    rss_dbm: RssDbm | None = None


class Truth(_Message):
    """Where the device really was, in replays: shown beside the estimate, never given to a method."""

    x_m: PlaceM
    y_m: PlaceM


class Interval(_Message):
    """One reading set at one time of the device's clock."""

    t_ms: Annotated[float, Field(ge=0.0, le=LATEST_MS)]
    readings: Annotated[list[Reading], Field(max_length=MOST_READINGS)]
    links: Annotated[list[Link], Field(max_length=MOST_LINKS)] = []
    truth: Truth | None = None


class Measurements(_Message):
    """One reading set, or a backlog of them. Another ``recording`` starts the device's track anew."""

    version: Literal[1] = VERSION
    device: Name
    recording: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{0,64}$", max_length=64)] = ""
    intervals: Annotated[list[Interval], Field(min_length=1, max_length=MOST_INTERVALS)]


class Receipt(_Message):
    """What became of a batch. All that is counted as accepted or duplicate is stored."""

    version: Literal[1] = VERSION
    accepted: int
    duplicate: int
    late: int
    skewed: int
    unknown_access_points: int


class Ellipse(_Message):
    """The region of 95 % around a position; the angle is that of the major axis from x towards y."""

    semi_major_m: float
    semi_minor_m: float
    angle_rad: float


class Position(_Message):
    """Where a device is.

    ``x_m`` and ``y_m`` are those of the last fix; ``age_ms`` is how long ago its readings came in. ``reason`` says
    why the latest reading set gave none, ``fixed`` if it did.
    """

    device: str
    recording: str
    t_ms: float
    age_ms: float | None
    is_silent: bool
    x_m: float | None
    y_m: float | None
    ellipse95: Ellipse | None
    reason: str
    access_points: int
    method: str
    truth_x_m: float | None
    truth_y_m: float | None


class Positions(_Message):
    """The latest of all devices; also what is pushed each tick."""

    version: Literal[1] = VERSION
    site: str
    tick: int
    server_ms: float
    is_overloaded: bool
    devices: list[Position]


class HeardReading(_Message):
    """One access point in the latest reading set of a device, as the method saw it: no offset removed."""

    name: str
    bssid: str
    range_m: float | None
    rss_dbm: float | None


class DeviceDetail(_Message):
    """A device with what it heard last."""

    version: Literal[1] = VERSION
    position: Position
    readings: list[HeardReading]


class TrackPoint(_Message):
    """One reading set of a track."""

    recording: str
    t_ms: float
    x_m: float | None
    y_m: float | None
    variance_x_m2: float | None
    variance_y_m2: float | None
    covariance_xy_m2: float | None
    reason: str
    access_points: int
    method: str
    truth_x_m: float | None
    truth_y_m: float | None


class DeviceTrack(_Message):
    """Part of a device's track, oldest first; ``is_complete`` is false where the limit cut it short."""

    version: Literal[1] = VERSION
    site: str
    device: str
    is_complete: bool
    points: list[TrackPoint]


class AccessPointPlace(_Message):
    """An access point of a site."""

    name: str
    bssid: str
    x_m: float
    y_m: float
    height_m: float


class PlanPlace(_Message):
    """The plan's picture: ``(x_m, y_m) = metres_from_pixels @ (column, row, 1)``, integers being pixel centres."""

    url: str
    width_px: int
    height_px: int
    metres_from_pixels: list[list[float]]


class SiteDescription(_Message):
    """What the map needs of a site."""

    version: Literal[1] = VERSION
    name: str
    is_made_up: bool
    device_height_m: float
    method: str
    speed_prior_mps: float
    tick_ms: float
    access_points: list[AccessPointPlace]
    plan: PlanPlace


class Refusal(_Message):
    """Why a request was refused: a reason for programs, a sentence for people."""

    version: Literal[1] = VERSION
    reason: str
    message: str
