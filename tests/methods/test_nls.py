from __future__ import annotations

from dataclasses import replace

import torch

from fploc.intervals import Intervals, NoFix
from fploc.methods.nls import NAME, nls
from fploc.methods.nls_robust import read_settings
from rooms import room

SITE = room([(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)])


def interval(positions: torch.Tensor, heard: torch.Tensor) -> Intervals:
    ranges = torch.cdist(positions, torch.from_numpy(SITE.positions_m))
    return Intervals(
        t_s=torch.zeros(len(positions)),
        ranges=torch.where(heard, ranges, 0.0).float(),
        stds=torch.zeros_like(ranges),
        rss=torch.zeros_like(ranges),
        heard=heard,
        present=torch.ones(len(positions), dtype=torch.bool),
    )


def test_it_uses_every_range() -> None:
    truth = torch.tensor([[4.0, 5.0], [4.0, 5.0]], dtype=torch.float64)
    heard = torch.tensor([[True] * 4, [True, True, False, False]])
    _, found = nls().step(nls().init(SITE, 2), interval(truth, heard))
    torch.testing.assert_close(found.positions[0], truth[0], atol=1e-5, rtol=0)
    assert found.reasons.tolist() == [NoFix.FIXED, NoFix.TOO_FEW_RANGES]


def test_an_offset_common_to_all_ranges_spreads_the_covariance() -> None:
    truth = torch.tensor([[4.0, 5.0]], dtype=torch.float64)
    here = torch.ones(1, 4, dtype=torch.bool)
    clean = interval(truth, here)
    late = Intervals(clean.t_s, clean.ranges + 6.0, clean.stds, clean.rss, clean.heard, clean.present)
    method = nls(replace(read_settings(NAME), sigma_m=1.0, sigma_per_m=0.0))
    state = method.init(SITE, 1)
    honest, spoilt = method.step(state, clean)[1], method.step(state, late)[1]
    assert spoilt.covariances[0].trace() > 4 * honest.covariances[0].trace()
