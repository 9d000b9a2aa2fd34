from __future__ import annotations

import numpy as np
import pytest
import torch

from fploc.virtual.dropout import Dropout


def test_shares_are_counted_in_bins_of_5_m() -> None:
    distances = np.array([[0.0, 4.9, 5.0], [9.9, 7.0, 16.0]])
    heard = np.array([[True, True, True], [False, True, False]])
    assert Dropout.fit(distances, heard).heard_shares == pytest.approx((1.0, 2 / 3, 0.0, 0.0))


def test_samples_have_the_shares_and_the_last_bin_holds_all_beyond() -> None:
    dropout = Dropout((0.9, 0.5, 0.2))
    distances = torch.tensor([0.0, 4.9, 5.0, 12.0, 14.9, 15.1, 400.0]).expand(20_000, 7)
    heard = dropout.sample(distances, torch.Generator().manual_seed(0))
    assert heard.shape == distances.shape and heard.dtype == torch.bool
    np.testing.assert_allclose(heard.float().mean(0), [0.9, 0.9, 0.5, 0.2, 0.2, 0.2, 0.2], atol=0.015)


def test_certain_links_are_always_or_never_heard() -> None:
    heard = Dropout((1.0, 0.0)).sample(torch.tensor([1.0, 6.0]).expand(500, 2), torch.Generator())
    assert heard[:, 0].all() and not heard[:, 1].any()


def test_fitted_shares_come_back_from_samples() -> None:
    random = np.random.default_rng(0)
    distances = random.uniform(0, 30, 40_000)
    heard = random.random(40_000) < np.exp(-distances / 20)
    fitted = Dropout.fit(distances, heard)
    sampled = fitted.sample(torch.from_numpy(distances), torch.Generator().manual_seed(1))
    again = Dropout.fit(distances, sampled.numpy())
    np.testing.assert_allclose(again.heard_shares, fitted.heard_shares, atol=0.03)


def test_one_seed_gives_one_sample() -> None:
    dropout, distances = Dropout((0.5,)), torch.ones(100)
    one, two, other = (dropout.sample(distances, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2))
    assert torch.equal(one, two) and not torch.equal(one, other)
