"""What is stored of a device: reading sets that wait or that no stored state has seen, fixes, and that state."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WaitingRow:
    """A reading set that was accepted and that no stored state has seen; ``body`` is its ``Interval`` as JSON."""

    site: str
    device: str
    track: int
    recording: str
    t_ms: float
    received_ms: float
    body: str


@dataclass(frozen=True)
class FixRow:
    """What was made of one reading set; positions in metres, site frame, None where there was no fix."""

    site: str
    device: str
    track: int
    recording: str
    t_ms: float
    received_ms: float
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


@dataclass(frozen=True)
class DeviceRow:
    """How far a device has come.

    Args:
        site: Name of the site.
        device: As it calls itself.
        track: Number of its track.
        recording: As it names it.
        t_ms: Time of the last reading set used, device clock.
        received_ms: When that came in, server's clock.
        fix: Last ``FixRow`` with a position, as JSON; empty where there was none.
    """

    site: str
    device: str
    track: int
    recording: str
    t_ms: float
    received_ms: float
    fix: str


@dataclass(frozen=True)
class StateRow:
    """The state of a device after one of its reading sets; it goes on from here by those that came after.

    Args:
        site: Name of the site.
        device: As it calls itself.
        track: Of the reading set.
        t_ms: Of the reading set, device clock.
        layout: What ``state`` can be restored into.
        state: Of method and filter.
    """

    site: str
    device: str
    track: int
    t_ms: float
    layout: str
    state: bytes
