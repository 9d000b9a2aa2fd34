from __future__ import annotations

import pytest

from fploc.serve import upload_spacing
from fploc.serve.upload_spacing import LONGEST_S, SHEDDING_S, UploadSpacing

TICK_S = 0.2
LATE_SHARE = 0.25


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_phones_may_upload_as_often_as_they_like_while_ticks_are_in_time() -> None:
    spacing = UploadSpacing(Clock(), LATE_SHARE)
    spacing.note_tick(0.04, TICK_S)
    assert [spacing.wait_s("a") for _ in range(5)] == [0.0] * 5
    assert not spacing.is_shedding


def test_late_ticks_hold_every_phone_to_the_same_time_between_uploads() -> None:
    clock = Clock()
    spacing = UploadSpacing(clock, LATE_SHARE)
    for _ in range(14):
        spacing.note_tick(0.1, TICK_S)
    uploads = {"often": 0, "seldom": 0}
    for step in range(1000):
        clock.now_s = 0.1 * step
        uploads["often"] += spacing.wait_s("often") == 0.0
        uploads["seldom"] += step % 4 == 0 and spacing.wait_s("seldom") == 0.0
    expected = 100.0 / spacing.spacing_s
    assert uploads["often"] == pytest.approx(expected, rel=0.1)
    assert uploads["seldom"] == pytest.approx(expected, rel=0.2)


def test_the_time_between_uploads_has_bounds_and_goes_back_to_none() -> None:
    spacing = UploadSpacing(Clock(), LATE_SHARE)
    for _ in range(100):
        spacing.note_tick(1.0, TICK_S)
    assert spacing.spacing_s == LONGEST_S
    for _ in range(300):
        spacing.note_tick(0.0, TICK_S)
    assert spacing.spacing_s == 0.0


def test_it_says_for_a_while_that_it_sheds_load() -> None:
    clock = Clock()
    spacing = UploadSpacing(clock, LATE_SHARE)
    spacing.note_tick(1.0, TICK_S)
    assert spacing.wait_s("a") == 0.0 and not spacing.is_shedding
    assert spacing.wait_s("a") == pytest.approx(spacing.spacing_s) and spacing.is_shedding
    clock.now_s = 1.01 * SHEDDING_S
    assert not spacing.is_shedding and spacing.wait_s("a") == 0.0


def test_it_remembers_no_more_phones_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upload_spacing, "MOST_PHONES", 2)
    spacing = UploadSpacing(Clock(), LATE_SHARE)
    spacing.note_tick(1.0, TICK_S)
    assert [spacing.wait_s(phone) == 0.0 for phone in "abca"] == [True] * 4
    assert spacing.wait_s("c") > 0.0
