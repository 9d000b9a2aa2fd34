from __future__ import annotations

from fploc.serve.upload_limit import FEWEST, KEPT_WHEN_LATE, SHEDDING_S, UploadLimit


def test_room_is_taken_and_given_back() -> None:
    limit = UploadLimit(2, lambda: 0.0)
    assert [limit.enter() for _ in range(3)] == [True, True, False]
    limit.leave()
    assert limit.enter() and not limit.enter()


def test_late_ticks_take_room_and_ticks_in_time_give_it_back() -> None:
    limit = UploadLimit(100, lambda: 0.0)
    limit.note_tick(0.09, 0.2)
    assert limit.room == 100
    limit.note_tick(0.11, 0.2)
    assert limit.room == int(100 * KEPT_WHEN_LATE)
    for _ in range(50):
        limit.note_tick(1.0, 0.2)
    assert limit.room == FEWEST
    for _ in range(200):
        limit.note_tick(0.0, 0.2)
    assert limit.room == 100


def test_it_says_for_a_second_that_it_turned_something_away() -> None:
    now = [0.0]
    limit = UploadLimit(0, lambda: now[0])
    assert not limit.is_shedding
    assert not limit.enter() and limit.is_shedding
    now[0] = 0.99 * SHEDDING_S
    assert limit.is_shedding
    now[0] = 1.01 * SHEDDING_S
    assert not limit.is_shedding
