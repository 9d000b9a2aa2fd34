from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.packed import read_packed
from fploc.datasets.recordings import Recording
from fploc.evaluation.evaluate import EvaluationRequest, source_offsets
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import Localizer, Track, localize
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.methods.registry import GEOMETRIC_METHODS, default_calibration, geometric_method
from fploc.serve.messages import Interval, Measurements, Position, Reading
from fploc.serve.recorded import recorded_intervals
from fploc.serve.rows import DeviceRow, FixRow, StateRow, WaitingRow
from fploc.serve.session import Outcome, SiteSession
from fploc.serve.settings import ServeSettings
from fploc.shipped import shipped_localizer
from fploc.sites.site import Site

BOX_MAC = "00:00:00:00:00:0{}"


def message(device: str, *t_ms: float, recording: str = "") -> Measurements:
    readings = [Reading(bssid=BOX_MAC.format(index), range_m=9.0 + index) for index in range(4)]
    return Measurements(
        device=device, recording=recording, intervals=[Interval(t_ms=t, readings=readings) for t in t_ms]
    )


def follow(session: SiteSession, *devices: str) -> None:
    for device in devices:
        session.restore(None, None, [], device)


def streamed(
    session: SiteSession, site: Site, recordings: Sequence[Recording], seed: int
) -> dict[str, list[FixRow]]:
    """Return the fixes of recordings sent in bursts of 0 to 3 intervals, each burst in reverse order."""
    random = np.random.default_rng(seed)
    left = {f"phone-{index}": recorded_intervals(one, site) for index, one in enumerate(recordings)}
    fixes: dict[str, list[FixRow]] = {device: [] for device in left}
    follow(session, *left)
    now_ms = 0.0
    while any(left.values()):
        for device, intervals in left.items():
            burst = [intervals.pop(0) for _ in range(min(len(intervals), int(random.integers(0, 4))))]
            if burst:
                session.ingest(Measurements(device=device, intervals=burst[::-1]), now_ms)
        now_ms += 200.0
        for outcome in session.tick():
            for fix in outcome.fixes:
                fixes[fix.device].append(fix)
    return fixes


def largest_difference_m(fixes: Sequence[FixRow], offline: Track) -> float:
    path = offline.unfiltered if offline.filtered is None else offline.filtered
    online = np.array([(fix.x_m, fix.y_m) for fix in fixes], dtype=np.float64)
    np.testing.assert_array_equal(np.isfinite(online[:, 0]), path.fixed)
    assert path.fixed.sum() > len(path.fixed) / 2
    return float(np.nanmax(np.abs(online - path.positions_m)))


@pytest.mark.parametrize("method", GEOMETRIC_METHODS)
def test_every_method_gives_the_positions_of_offline_localization(
    method: str, recordings: list[Recording], localizer: Localizer, settings: ServeSettings
) -> None:
    made, site, offsets = geometric_method(method), localizer.site, localizer.offsets
    offline = localize(made, site, recordings, offsets, KalmanSettings())
    session = SiteSession(Localizer(made, site, offsets, KalmanSettings()), settings)
    fixes = streamed(session, site, recordings, seed=1)
    for online, track in zip(fixes.values(), offline, strict=True):
        assert largest_difference_m(online, track) < 1e-4


def test_the_default_method_gives_the_positions_of_offline_localization(
    recordings: list[Recording], localizer: Localizer, settings: ServeSettings
) -> None:
    made = shipped_localizer(localizer.site, None)
    offline = localize(made.method, made.site, recordings, made.offsets, None)
    fixes = streamed(SiteSession(made, settings), made.site, recordings, seed=1)
    for online, track in zip(fixes.values(), offline, strict=True):
        assert largest_difference_m(online, track) < 1e-4


def test_the_papers_chain_gives_the_positions_of_offline_localization(
    recordings: list[Recording],
    localizer: Localizer,
    settings: ServeSettings,
    untrained_chain: GNNFPDNN,
) -> None:
    site, offsets = localizer.site, localizer.offsets
    offline = localize(untrained_chain, site, recordings, offsets, KalmanSettings())
    session = SiteSession(Localizer(untrained_chain, site, offsets, KalmanSettings()), settings)
    fixes = streamed(session, site, recordings, seed=3)
    for online, track in zip(fixes.values(), offline, strict=True):
        assert largest_difference_m(online, track) < 1e-4


@pytest.mark.parametrize("site", ["shopping-mall", "laboratory"])
def test_a_replayed_measured_lap_gives_the_positions_of_offline_localization(
    site: str, data_root: Path, settings: ServeSettings
) -> None:
    packed = read_packed(data_root, site)
    laps = [lap.where(np.arange(len(lap)) < 60) for lap in packed.recordings()[::3]]
    request = EvaluationRequest("zero-shot", site, calibration=default_calibration("nls-onesided"))
    offsets, method = source_offsets(request, data_root), geometric_method("nls-onesided")
    offline = localize(method, packed.site, laps, offsets, KalmanSettings())
    session = SiteSession(Localizer(method, packed.site, offsets, KalmanSettings()), settings)
    fixes = streamed(session, packed.site, laps, seed=2)
    for online, track in zip(fixes.values(), offline, strict=True):
        assert largest_difference_m(online, track) < 1e-4


def test_what_was_seen_is_a_duplicate_and_what_is_older_is_late(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, settings)
    follow(session, "a")
    assert session.ingest(message("a", 1000.0, 1200.0), 0.0).verdicts == {"accepted": 2}
    assert session.ingest(message("a", 1200.0, 1100.0), 0.0).verdicts == {"duplicate": 1, "accepted": 1}
    session.tick()
    again = session.ingest(message("a", 1100.0, 1150.0, 1400.0), 100.0).verdicts
    assert again == {"duplicate": 1, "late": 1, "accepted": 1}


def test_a_clock_may_jump_only_as_far_as_the_servers_own_allows(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, settings)
    follow(session, "a")
    session.ingest(message("a", 1000.0), 0.0)
    hour_ms = 3_600_000.0
    assert session.ingest(message("a", hour_ms), 200.0).verdicts == {"skewed": 1}
    # Out of reach for an hour, and asleep for ten minutes of it: all of the backlog is taken.
    backlog = message("a", 2000.0, 600_000.0, hour_ms)
    assert session.ingest(backlog, hour_ms).verdicts == {"accepted": 3}


def test_a_clock_that_was_set_back_begins_a_track_anew(localizer: Localizer, settings: ServeSettings) -> None:
    session = SiteSession(localizer, settings)
    follow(session, "a")
    session.ingest(message("a", 900_000.0), 0.0)
    session.tick()
    assert session.ingest(message("a", 5.0), 200.0).verdicts == {"late": 1}
    assert session.ingest(message("a", 5.0), 6000.0).verdicts == {"accepted": 1}
    ((fix,),) = (outcome.fixes for outcome in session.tick())
    assert (fix.track, fix.t_ms, fix.reason) == (1, 5.0, "fixed")


def test_another_recording_starts_from_nothing(
    recordings: list[Recording], localizer: Localizer, settings: ServeSettings
) -> None:
    first, second = (recorded_intervals(one, localizer.site) for one in recordings[:2])
    alone, after = SiteSession(localizer, settings), SiteSession(localizer, settings)
    follow(alone, "a")
    follow(after, "a")
    after.ingest(Measurements(device="a", recording="one", intervals=first), 0.0)
    for session in (alone, after):
        session.ingest(Measurements(device="a", recording="two", intervals=second), 1.0)
    expected = [fix.x_m for outcome in alone.tick() for fix in outcome.fixes]
    found = [fix.x_m for outcome in after.tick() for fix in outcome.fixes]
    assert found[len(first) :] == expected


class Stored:
    """What a store would hold of one device."""

    def __init__(self) -> None:
        self.device: DeviceRow | None = None
        self.state: StateRow | None = None
        self.waiting: list[WaitingRow] = []

    def write(self, rows: Sequence[WaitingRow], outcomes: Sequence[Outcome]) -> None:
        self.waiting += rows
        for outcome in outcomes:
            self.device = outcome.devices[-1] if outcome.devices else self.device
            for state in outcome.states:
                self.state = state
                seen = state.track, state.t_ms
                self.waiting = [row for row in self.waiting if (row.track, row.t_ms) > seen]


@pytest.mark.parametrize("every", [1, 4, 100])
@pytest.mark.parametrize("method", ["nls-onesided", "default"])
def test_a_session_goes_on_from_what_was_stored(
    method: str, every: int, recordings: list[Recording], localizer: Localizer, settings: ServeSettings
) -> None:
    served = shipped_localizer(localizer.site, None) if method == "default" else localizer
    seldom = replace(settings, store_states_every=every)
    intervals = recorded_intervals(recordings[0], localizer.site)
    whole, before, restored = (SiteSession(served, seldom) for _ in range(3))
    follow(whole, "a")
    follow(before, "a")
    whole.ingest(Measurements(device="a", intervals=intervals), 0.0)
    expected = [fix for outcome in whole.tick() for fix in outcome.fixes]
    stored = Stored()
    stored.write(before.ingest(Measurements(device="a", intervals=intervals[:10]), 0.0).rows, before.tick())
    # It ends with these waiting.
    stored.write(before.ingest(Measurements(device="a", intervals=intervals[10:15]), 0.0).rows, [])
    assert len(stored.waiting) == 5 + 10 % every
    restored.restore(stored.device, stored.state, stored.waiting, "a")
    verdicts = restored.ingest(Measurements(device="a", intervals=intervals[13:]), 0.0).verdicts
    assert verdicts == {"duplicate": 2, "accepted": len(intervals) - 15}
    found = [fix for outcome in restored.tick() for fix in outcome.fixes]
    assert found == expected[10 - 10 % every :]


def test_after_a_restart_what_was_late_stays_late(localizer: Localizer, settings: ServeSettings) -> None:
    first, second = (SiteSession(localizer, replace(settings, store_states_every=100)) for _ in range(2))
    follow(first, "a")
    stored = Stored()
    stored.write(first.ingest(message("a", 1000.0, 1200.0, 1400.0), 0.0).rows, first.tick())
    second.restore(stored.device, stored.state, stored.waiting, "a")
    verdicts = second.ingest(message("a", 1100.0, 1200.0, 1300.0, 1600.0), 0.0).verdicts
    assert verdicts == {"late": 2, "duplicate": 1, "accepted": 1}
    outcomes = second.tick()
    assert [fix.t_ms for outcome in outcomes for fix in outcome.fixes] == [1000.0, 1200.0, 1400.0, 1600.0]
    # The place that a device had reached goes back by no restart.
    assert [row.t_ms for outcome in outcomes for row in outcome.devices] == [1400.0, 1400.0, 1400.0, 1600.0]


def test_states_are_stored_now_and_then_and_when_nobody_follows_any_more(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, replace(settings, store_states_every=3))
    follow(session, "a", "b")
    for name in ("a", "b"):
        session.ingest(message(name, 1.0, 2.0, 3.0, 4.0), 0.0)
    stored = [[(row.device, row.t_ms) for row in outcome.states] for outcome in session.tick()]
    # The second slot is stored one interval earlier: states of many devices are not stored all at once.
    assert stored == [[], [("b", 2.0)], [("a", 3.0)], []]
    left = [(row.device, row.t_ms) for row in session.unstored().states]
    assert left == [("a", 4.0), ("b", 4.0)] and session.unstored().states == []
    session.ingest(message("b", 5.0), 0.0)
    session.tick()
    gone = session.forget_silent(settings.forget_ms + 1.0)
    assert [(row.device, row.t_ms) for row in gone.states] == [("b", 5.0)] and not session.devices


def test_devices_share_the_queue_alike(localizer: Localizer, settings: ServeSettings) -> None:
    session = SiteSession(localizer, replace(settings, most_waiting=20, most_devices=3))
    follow(session, "a", "b")
    session.ingest(message("a", *(float(t) for t in range(5))), 0.0)
    assert session.has_room_for_intervals("a", 5) and not session.has_room_for_intervals("a", 6)
    follow(session, "c")
    assert not session.has_room_for_intervals("a", 2)
    assert session.has_room_for("c") and not session.has_room_for("d")


def test_a_backlog_longer_than_a_share_is_taken_until_the_queue_is_full(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, replace(settings, most_waiting=20))
    follow(session, "a", "b", "c")
    assert session.has_room_for_intervals("a", 30) and not session.is_full
    session.ingest(message("a", *(float(t) for t in range(30))), 0.0)
    assert session.is_full and not session.has_room_for_intervals("b", 30)
    assert session.has_room_for_intervals("b", 6)
    session.tick()
    assert session.has_room_for_intervals("b", 30) and not session.is_full


def test_a_round_takes_the_longest_waiting_devices_first(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, replace(settings, most_at_once=1))
    follow(session, "a", "b")
    session.ingest(message("b", 1.0, 2.0), 0.0)
    session.ingest(message("a", 1.0, 2.0), 5.0)
    assert [outcome.fixes[0].device for outcome in session.tick()] == ["b", "b", "a", "a"]
    assert session.tick(budget_s=0.0) == []


def test_slots_grow_and_are_given_back(localizer: Localizer, settings: ServeSettings) -> None:
    session = SiteSession(localizer, settings)
    names = [f"phone-{index}" for index in range(130)]
    follow(session, *names)
    for name in names:
        session.ingest(message(name, 1.0), 0.0)
    (outcome,) = session.tick()
    assert {fix.device for fix in outcome.fixes} == set(names)
    assert len({(fix.x_m, fix.y_m) for fix in outcome.fixes}) == 1
    session.forget_silent(settings.forget_ms)
    assert list(session.devices) == names
    session.forget_silent(settings.forget_ms + 1.0)
    assert not session.devices
    assert session.positions(0.0) == []


def test_positions_keep_the_schema_and_show_the_last_fix(
    localizer: Localizer, settings: ServeSettings
) -> None:
    session = SiteSession(localizer, settings)
    follow(session, "a", "b")
    session.ingest(message("a", 1.0), 0.0)
    nothing = Measurements(device="a", intervals=[Interval(t_ms=2.0, readings=[])])
    session.ingest(nothing, 100.0)
    session.tick()
    (shown,) = [Position.model_validate(one) for one in session.positions(20_000.0)]
    assert (shown.reason, shown.access_points, shown.is_silent, shown.age_ms) == (
        "no_reading",
        0,
        True,
        20_000.0,
    )
    assert shown.x_m is not None and shown.ellipse95 is not None


def test_strangers_and_useless_ranges_do_not_count(localizer: Localizer, settings: ServeSettings) -> None:
    session = SiteSession(localizer, settings)
    follow(session, "a")
    readings = [
        Reading(bssid="ff:ff:ff:ff:ff:ff", range_m=3.0),
        Reading(bssid=BOX_MAC.format(0), range_m=-0.5),
        Reading(bssid=BOX_MAC.format(1), range_m=100.0),
        Reading(bssid=BOX_MAC.format(2).upper(), range_m=8.0),
    ]
    done = session.ingest(Measurements(device="a", intervals=[Interval(t_ms=1.0, readings=readings)]), 0.0)
    assert done.unknown_access_points == 1
    ((fix,),) = (outcome.fixes for outcome in session.tick())
    assert (fix.access_points, fix.reason, fix.x_m) == (1, "too_few_ranges", None)
