from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from fploc.serve import upload_turns
from fploc.serve.upload_turns import LOWEST_PER_S, READING_SETS_OF_A_REQUEST, SHEDDING_S, UploadTurns

TICK_S, PERIOD_S = 0.2, 0.2
BEHIND, IN_TIME = 1.5, 0.5
SLOT_S = (1 + READING_SETS_OF_A_REQUEST) / LOWEST_PER_S
"""Of an upload of one reading set."""


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def in_line(clock: Clock) -> UploadTurns:
    """Return turns of a server that lets in ``LOWEST_PER_S``."""
    turns = UploadTurns(clock)
    turns.note_tick("box", BEHIND, 0)
    return turns


def test_phones_may_upload_as_often_as_they_like_while_the_server_keeps_up() -> None:
    turns = UploadTurns(Clock())
    turns.note_tick("box", IN_TIME, 0)
    assert [turns.wait_s("a") for _ in range(5)] == [0.0] * 5
    assert not turns.is_shedding and turns.line_s == 0.0


def test_behind_it_phones_have_one_place_each_in_the_order_of_asking() -> None:
    clock = Clock()
    turns = in_line(clock)
    assert [turns.wait_s(phone) for phone in "abacaab"] == pytest.approx(
        [0.0, SLOT_S, 2 * SLOT_S, 3 * SLOT_S, 2 * SLOT_S, 2 * SLOT_S, SLOT_S]
    )
    assert turns.line_s == pytest.approx(4 * SLOT_S)
    clock.now_s = 2.01 * SLOT_S
    assert [turns.wait_s(phone) == 0.0 for phone in "cab"] == [False, True, True]


def test_who_comes_late_keeps_the_turn_and_holds_nobody_up() -> None:
    clock = Clock()
    turns = in_line(clock)
    for phone in "abc":
        turns.wait_s(phone)
    clock.now_s = 60.0
    assert turns.wait_s("c") == 0.0 and turns.wait_s("b") == 0.0
    assert turns.wait_s("d") == 0.0 < turns.wait_s("e")


@pytest.mark.parametrize(("pressure", "for_one"), [(1.01, 0.995), (1.5, 0.75), (50.0, 0.5)])
def test_as_much_is_let_in_as_comes_out_less_the_farther_behind_the_server_is(
    pressure: float, for_one: float
) -> None:
    clock = Clock()
    turns = UploadTurns(clock)
    for _ in range(100):
        clock.now_s += TICK_S
        turns.note_tick("box", pressure, 200)
    for index in range(101):
        turns.wait_s(f"phone-{index}")
    # What comes out are uploads of one reading set each.
    assert turns.wait_s("phone-100") == pytest.approx(100 / (for_one * 200 / TICK_S))


def test_what_an_upload_brings_beyond_others_puts_the_next_turn_off() -> None:
    turns = in_line(Clock())
    for phone in "abcdefgh":
        turns.wait_s(phone)
    before_s = turns.line_s
    turns.charge("a", int(4 + 3 * READING_SETS_OF_A_REQUEST))
    # All wait until it is paid for; the phone itself waits as if it had stood in line four times.
    paid_s = 3 * SLOT_S
    assert turns.wait_s("b") == pytest.approx(SLOT_S + paid_s)
    assert turns.wait_s("a") == pytest.approx(4 * before_s + paid_s)


def test_a_turn_for_which_there_was_no_room_is_given_back() -> None:
    turns = in_line(Clock())
    assert turns.wait_s("a") == 0.0
    turns.give_back("a")
    assert turns.wait_s("a") == 0.0 < turns.wait_s("a")


def test_something_is_always_let_in_and_the_line_ends_with_the_load() -> None:
    clock = Clock()
    turns = in_line(clock)
    for _ in range(100):
        turns.note_tick("box", 100.0, 0)
    turns.wait_s("a")
    assert turns.wait_s("b") == pytest.approx(SLOT_S)
    for _ in range(int(SHEDDING_S / TICK_S) + 1):
        clock.now_s += TICK_S
        turns.note_tick("box", IN_TIME, 0)
    assert [turns.wait_s("b") for _ in range(3)] == [0.0] * 3


def test_the_site_that_is_farthest_behind_counts() -> None:
    clock = Clock()
    turns = in_line(clock)
    turns.note_tick("hall", IN_TIME, 0)
    assert turns.wait_s("a") == 0.0 < turns.wait_s("a")


def test_it_says_for_a_while_that_it_sheds_load() -> None:
    clock = Clock()
    turns = in_line(clock)
    assert turns.wait_s("a") == 0.0 and not turns.is_shedding
    assert turns.wait_s("a") > 0.0 and turns.is_shedding
    clock.now_s = 1.01 * SHEDDING_S
    assert not turns.is_shedding and turns.wait_s("a") == 0.0


def test_it_remembers_no_more_phones_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upload_turns, "MOST_PHONES", 2)
    clock = Clock()
    turns = in_line(clock)
    for phone in "abcd":
        turns.wait_s(phone)
    clock.now_s = 3.5 * SLOT_S
    assert [turns.wait_s(phone) == 0.0 for phone in "dcb"] == [True, True, False]


SIMULATED_S = 240.0
AT_ONCE = 50


@dataclass
class SimulatedPhone:
    """Measures five times a second and keeps what was not taken in; a rude one never heeds when to come again."""

    is_rude: bool
    at_once: int
    not_before_s: float
    kept: float = 0.0
    taken: int = 0

    def upload(self, turns: UploadTurns, name: str, now_s: float) -> int:
        self.kept += TICK_S / PERIOD_S
        if now_s < self.not_before_s:
            return 0
        wait_s = turns.wait_s(name)
        if wait_s > 0.0:
            self.not_before_s = now_s if self.is_rude else now_s + math.ceil(wait_s)
            return 0
        brought = min(int(self.kept), self.at_once)
        turns.charge(name, brought)
        self.kept -= brought
        self.taken += brought
        return brought


def ticks(
    turns: UploadTurns,
    clock: Clock,
    phones: list[SimulatedPhone],
    work_per_s: Callable[[float], float],
    most_waiting: float,
    *,
    spread_s: float,
) -> Iterator[float]:
    """Yield what waits at every tick of a server that works at a rate on requests and what they bring.

    Args:
        turns: Of the server.
        clock: Of ``turns``.
        phones: Those that upload.
        work_per_s: By the time, seconds.
        most_waiting: With so much the server is behind.
        spread_s: Between the first phone of a tick and the last.
    """
    waiting = 0.0
    for step in range(int(SIMULATED_S / TICK_S)):
        requests = 0
        for index, phone in enumerate(phones):
            clock.now_s = step * TICK_S + spread_s * index / len(phones)
            brought = phone.upload(turns, str(index), clock.now_s)
            waiting += brought
            requests += brought > 0
        work = TICK_S * work_per_s(step * TICK_S)
        used = min(waiting, max(0.0, work - READING_SETS_OF_A_REQUEST * requests))
        waiting -= used
        turns.note_tick("box", waiting / most_waiting, int(used))
        yield waiting


def simulated(phones: list[SimulatedPhone], work_per_s: float, most_waiting: float) -> list[float]:
    """Return what waited at every tick of a server that always works alike, its phones spread over the tick."""
    clock = Clock()
    turns = UploadTurns(clock)
    return list(ticks(turns, clock, phones, lambda _: work_per_s, most_waiting, spread_s=TICK_S))


def jain(shares: list[int]) -> float:
    values = np.array(shares, dtype=np.float64)
    return float(values.sum() ** 2 / (len(values) * np.square(values).sum()))


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_past_capacity_phones_fare_alike_and_no_queue_grows(share: float) -> None:
    phones = [SimulatedPhone(is_rude=False, at_once=AT_ONCE, not_before_s=0.0) for _ in range(200)]
    capacity = share * 200 / PERIOD_S
    waited = simulated(phones, capacity, most_waiting=2 * capacity)
    taken = [phone.taken for phone in phones]
    assert jain(taken) > 0.99 and min(taken) > 0.85 * float(np.median(taken))
    half = len(waited) // 2
    assert max(waited[half:]) < 8 * capacity
    assert sum(taken) > 0.6 * capacity * SIMULATED_S


def test_past_capacity_phones_that_never_stop_asking_get_little_more() -> None:
    phones = [
        SimulatedPhone(is_rude=index % 4 == 0, at_once=AT_ONCE, not_before_s=0.0) for index in range(200)
    ]
    simulated(phones, 500.0, most_waiting=1000.0)
    rude, polite = ([phone.taken for phone in phones if phone.is_rude is kind] for kind in (True, False))
    assert np.mean(rude) < 1.3 * np.mean(polite)
    assert jain(rude + polite) > 0.97


def test_past_capacity_uploads_ten_times_as_large_bring_far_less_than_ten_times_as_much() -> None:
    sizes = {0: 200, 1: 20}
    phones = [
        SimulatedPhone(is_rude=False, at_once=sizes[index % 2], not_before_s=0.0) for index in range(200)
    ]
    simulated(phones, 300.0, most_waiting=1000.0)
    large, small = (
        np.mean([phone.taken for phone in phones if phone.at_once == size]) for size in sizes.values()
    )
    assert large < 5 * small


def test_phones_that_ask_in_step_do_not_keep_a_line_alive_that_nobody_needs() -> None:
    clock = Clock()
    turns = UploadTurns(clock)
    phones = [SimulatedPhone(is_rude=False, at_once=AT_ONCE, not_before_s=0.0) for _ in range(50)]
    work_per_s = 2 * len(phones) * (1 + READING_SETS_OF_A_REQUEST) / PERIOD_S

    def stalling(now_s: float) -> float:
        """The server stands still for three seconds; else it does twice the work that there is."""
        return 0.0 if 5.0 <= now_s < 8.0 else work_per_s

    line_s = [turns.line_s for _ in ticks(turns, clock, phones, stalling, 500, spread_s=0.0)]
    assert max(line_s) > 0.5
    assert not any(line_s[len(line_s) // 2 :])
