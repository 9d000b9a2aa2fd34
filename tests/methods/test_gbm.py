from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from fploc.errors import FplocError
from fploc.intervals import Intervals
from fploc.methods.gbm import Gbm, GbmSettings
from fploc.methods.interface import Examples
from rooms import room

PLACES = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (9.0, 6.0)]
SITE = room(PLACES)
SETTINGS = replace(GbmSettings.read(), trees=20, learning_rate=0.4, samples_per_leaf=5, learn_every=1)
EXCESS_M, FAINT_DBM = 4.0, -80.0


def walked(seed: int) -> Examples:
    """Return two recordings in which every faint range is 4 m too long, and all of them err by a centimetre."""
    generator = torch.Generator().manual_seed(seed)
    truth = torch.rand(150, 2, 2, generator=generator, dtype=torch.float64) * 14
    distances = (truth[:, :, None, :] - torch.tensor(PLACES, dtype=torch.float64)).norm(dim=-1)
    faint = torch.rand(distances.shape, generator=generator) < 0.4
    noise = 0.01 * torch.randn(distances.shape, generator=generator, dtype=torch.float64)
    intervals = Intervals(
        t_s=(torch.arange(150, dtype=torch.float64) * 0.4)[:, None].expand(-1, 2),
        ranges=(distances + EXCESS_M * faint + noise).clamp(min=0.0),
        stds=torch.full_like(distances, 0.2),
        rss=torch.where(faint, FAINT_DBM, -50.0).double(),
        heard=torch.ones_like(faint),
        present=torch.ones(150, 2, dtype=torch.bool),
    )
    return Examples(SITE, None, intervals, truth, torch.ones(truth.shape[1], dtype=torch.int64))


def test_what_faint_ranges_have_too_much_is_taken_off() -> None:
    method = Gbm(SETTINGS).fitted([walked(0)])
    unseen = walked(1)
    state = method.init(SITE, 2)
    for step in range(20):
        state, found = method.step(state, unseen.intervals.at(step))
        assert found.fixed.all()
        assert ((found.positions - unseen.labels[step]).norm(dim=-1) < 0.2).all()


def test_ranges_that_err_more_weigh_less() -> None:
    learned = walked(0)
    faint = learned.intervals.rss == FAINT_DBM
    generator = torch.Generator().manual_seed(3)
    noise = 3 * torch.randn(faint.shape, generator=generator, dtype=torch.float64) * faint
    noisy = replace(learned.intervals, ranges=(learned.intervals.ranges + noise).clamp(min=0.0))
    method = Gbm(SETTINGS).fitted([replace(learned, intervals=noisy)])
    distances = (learned.labels[0, :, None, :] - torch.tensor(PLACES, dtype=torch.float64)).norm(dim=-1)
    traces = []
    for rss_dbm, excess_m in ((-50.0, 0.0), (FAINT_DBM, EXCESS_M)):
        rss = torch.full_like(distances, rss_dbm)
        one = replace(learned.intervals.at(0), ranges=distances + excess_m, rss=rss)
        traces.append(method.step(method.init(SITE, 2), one)[1].covariances[0].trace())
    assert traces[1] > 3 * traces[0]


def test_one_recording_is_too_few_to_learn_from() -> None:
    learned = walked(0)
    unlabelled = learned.labels.clone()
    unlabelled[:, 1] = torch.nan
    with pytest.raises(FplocError, match="1 labelled recordings to learn from"):
        Gbm(SETTINGS).fitted([replace(learned, labels=unlabelled)])
