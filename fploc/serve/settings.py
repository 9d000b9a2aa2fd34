"""Settings of the server: conf/serve/."""

from __future__ import annotations

from dataclasses import dataclass

from fploc.conf import instantiate, read_conf


@dataclass(frozen=True)
class ServeSettings:
    """Limits and times of the server.

    Args:
        tick_ms: Time between ticks.
        speed_prior_mps: How fast filters take people to be, metres per second; `--speed-prior` takes its place.
        late_share: Share of a tick after which one that has not begun is late: after two, phones take turns.
        waiting_share: Share of ``most_waiting`` after which so much waits behind a tick that phones must upload less.
        compute_share: Share of a tick after which no further round of intervals is begun.
        most_at_once: Devices in one batch; the ones that wait longest go first.
        most_devices: Devices of a site that are followed at one time.
        most_waiting: Intervals of a site that may wait, and a backlog beyond; its devices share them alike.
        store_states_every: Reading sets of a device after which its state is stored; those since are used again
            after a restart.
        silent_ms: A device that sent nothing for so long is marked silent.
        forget_ms: A device that sent nothing for so long leaves the map; its track stays stored.
        longest_clock_jump_ms: A device's clock may jump so far forward, or farther where the server's own clock
            accounts for it, and stay so far behind.
        clock_restart_ms: A device that sends only what is older than that for so long has set its clock back.
        keep_tracks_ms: Fixes older than this are deleted.
        most_body_bytes: Largest body of a request.
        most_requests_in_flight: Requests that are worked on at one time; more are turned away.
        requests_per_s: Of one token, and of one address where none is needed.
        request_burst: Requests that a token may make at once.
        most_live: Live connections at one time.
        most_track_points: Points of one answer.
        is_read_anonymous: True lets anyone read, without a token.
    """

    tick_ms: float
    speed_prior_mps: float
    late_share: float
    waiting_share: float
    compute_share: float
    most_at_once: int
    most_devices: int
    most_waiting: int
    store_states_every: int
    silent_ms: float
    forget_ms: float
    longest_clock_jump_ms: float
    clock_restart_ms: float
    keep_tracks_ms: float
    most_body_bytes: int
    most_requests_in_flight: int
    requests_per_s: float
    request_burst: int
    most_live: int
    most_track_points: int
    is_read_anonymous: bool

    @classmethod
    def read(cls, name: str) -> ServeSettings:
        """Return the settings in ``conf/serve/<name>.yaml``.

        Raises:
            UnknownNameError: If there is no such file.
            BadFileError: If it does not fit.
        """
        return instantiate(cls, read_conf("serve", name), source=f"conf/serve/{name}.yaml")
