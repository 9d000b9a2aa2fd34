from __future__ import annotations

from dataclasses import replace

import torch

from fploc.intervals import Intervals
from fploc.methods.link_history import LONGEST_SILENCE_S, LinkHistory

WINDOWS_S = torch.tensor([1.0, 4.0], dtype=torch.float64)
SILENCE, RANGE_AGAINST_MEAN, RESTLESSNESS = 7, slice(8, 10), slice(12, 14)


def interval(t_s: float, ranges: list[float], rss: list[float]) -> Intervals:
    measured = torch.tensor([ranges], dtype=torch.float64)
    return Intervals(
        t_s=torch.tensor([t_s], dtype=torch.float64),
        ranges=measured,
        stds=torch.full_like(measured, 0.3),
        rss=torch.tensor([rss], dtype=torch.float64),
        heard=measured > 0,
        present=torch.ones(1, dtype=torch.bool),
    )


def test_an_interval_is_compared_within_itself() -> None:
    now = interval(0.0, [4.0, 9.0, 0.0], [-50.0, -63.0, 0.0])
    _, features = LinkHistory.before(1, 3, 2).after(now, WINDOWS_S)
    single = torch.tensor(
        [
            [4.0, 0.3, -50.0, 2.0, 0.0, 0.0, 0.0, LONGEST_SILENCE_S],
            [9.0, 0.3, -63.0, 2.0, 5.0, 13.0, 0.5, LONGEST_SILENCE_S],
        ],
        dtype=torch.float64,
    )
    torch.testing.assert_close(features[0, :2, :8], single)
    torch.testing.assert_close(features[0, :2, 8:], torch.zeros(2, 6, dtype=torch.float64))


def test_means_follow_exponentially_and_jumps_make_restless() -> None:
    history = LinkHistory.before(1, 1, 2)
    history, _ = history.after(interval(0.0, [5.0], [-60.0]), WINDOWS_S)
    history, features = history.after(interval(2.0, [8.0], [-60.0]), WINDOWS_S)
    kept = torch.exp(-2.0 / WINDOWS_S)
    torch.testing.assert_close(features[0, 0, RANGE_AGAINST_MEAN], 3.0 * kept)
    torch.testing.assert_close(features[0, 0, RESTLESSNESS], 3.0 * (1 - kept))
    assert features[0, 0, SILENCE] == 2.0


def test_links_and_devices_that_are_silent_keep_their_past() -> None:
    history, _ = LinkHistory.before(1, 2, 2).after(interval(0.0, [5.0, 6.0], [-60.0, -61.0]), WINDOWS_S)
    silent, _ = history.after(interval(1.0, [0.0, 7.0], [0.0, -61.0]), WINDOWS_S)
    assert silent.t_s.tolist() == [[0.0, 1.0]]
    torch.testing.assert_close(silent.ranges[:, 0], history.ranges[:, 0])
    away = replace(interval(1.0, [5.5, 7.0], [-60.0, -61.0]), present=torch.zeros(1, dtype=torch.bool))
    absent, _ = history.after(away, WINDOWS_S)
    torch.testing.assert_close(absent.ranges, history.ranges)


def test_the_future_changes_nothing() -> None:
    intervals = [interval(0.4 * step, [5.0 + step, 9.0 - step], [-60.0, -70.0]) for step in range(6)]
    seen = []
    for last in (4, 6):
        history = LinkHistory.before(1, 2, 2)
        collected = []
        for one in intervals[:last]:
            history, features = history.after(one, WINDOWS_S)
            collected.append(features)
        seen.append(torch.stack(collected[:4]))
    torch.testing.assert_close(seen[0], seen[1])
