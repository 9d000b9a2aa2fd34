from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from fploc.intervals import Intervals
from fploc.methods.nls import nls
from fploc.methods.rtt_rss import RttRss, RttRssSettings
from rooms import room

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]
SITE = room(CORNERS)
SETTINGS = RttRssSettings.read()


def interval(t_s: float, ranges: torch.Tensor, rss: torch.Tensor, heard: torch.Tensor) -> Intervals:
    return Intervals(
        t_s=torch.full((len(ranges),), t_s, dtype=torch.float64),
        ranges=torch.where(heard, ranges, 0.0),
        stds=torch.zeros_like(ranges),
        rss=torch.where(heard, rss, 0.0),
        heard=heard,
        present=torch.ones(len(ranges), dtype=torch.bool),
    )


def kalman_update(
    mean: float, variance: float, measured: float, noise: float, gate: float
) -> tuple[float, float]:
    """One scalar update as rivals.md writes it."""
    innovation = measured - mean
    spread = variance + noise
    if innovation**2 / spread > gate:
        noise *= innovation**2 / (gate * spread)
    gain = variance / (variance + noise)
    return mean + gain * innovation, (1 - gain) * variance


def test_every_link_goes_through_its_own_scalar_filter() -> None:
    generator = torch.Generator().manual_seed(2)
    steps, devices, links = 25, 2, len(CORNERS)
    ranges = 4 + 12 * torch.rand(steps, devices, links, generator=generator, dtype=torch.float64)
    ranges[11] = 90.0
    rss = -45 - 25 * torch.rand(steps, devices, links, generator=generator, dtype=torch.float64)
    heard = torch.rand(steps, devices, links, generator=generator) < 0.7
    method = RttRss()
    state = method.init(SITE, devices)
    for step in range(steps):
        state, _ = method.step(state, interval(0.4 * step, ranges[step], rss[step], heard[step]))
    slope = math.log(10) / (10 * SETTINGS.path_loss_exponent) * SETTINGS.rss_sd_db
    for device in range(devices):
        for link in range(links):
            mean, variance, last = math.nan, math.nan, math.nan
            for step in range(steps):
                if not heard[step, device, link]:
                    continue
                measured, now = float(ranges[step, device, link]), 0.4 * step
                if math.isnan(mean):
                    mean, variance = measured, SETTINGS.rtt_variance_m2
                else:
                    variance += SETTINGS.noise_m2_per_s * (now - last)
                    mean, variance = kalman_update(
                        mean, variance, measured, SETTINGS.rtt_variance_m2, SETTINGS.gate
                    )
                power = (SETTINGS.rss_at_1_m_dbm - float(rss[step, device, link])) / (
                    10 * SETTINGS.path_loss_exponent
                )
                mean, variance = kalman_update(
                    mean, variance, 10**power, (10**power * slope) ** 2, SETTINGS.gate
                )
                last = now
            assert float(state.ranges[device, link]) == pytest.approx(mean, rel=1e-9)
            assert float(state.variances[device, link]) == pytest.approx(variance, rel=1e-9)


def test_the_path_loss_gives_back_its_distances_and_their_spread() -> None:
    distances = torch.tensor([0.5, 1.0, 7.0, 30.0], dtype=torch.float64)
    rss = SETTINGS.rss_at_1_m_dbm - 10 * SETTINGS.path_loss_exponent * distances.log10()
    torch.testing.assert_close(SETTINGS.distances(rss), distances)
    step_db = 1e-4
    slope = (SETTINGS.distances(rss - step_db) - distances) / step_db
    torch.testing.assert_close(
        SETTINGS.rss_variances(distances), (slope * SETTINGS.rss_sd_db).square(), rtol=1e-4, atol=0
    )


def test_a_device_that_stands_is_found_better_than_from_one_interval() -> None:
    generator = torch.Generator().manual_seed(4)
    truth = torch.tensor([[6.0, 5.0]], dtype=torch.float64).expand(50, 2)
    distances = torch.cdist(truth, torch.tensor(CORNERS, dtype=torch.float64))
    heard = torch.ones_like(distances, dtype=torch.bool)
    method = RttRss(replace(SETTINGS, noise_m2_per_s=0.01))
    state = method.init(SITE, 50)
    for step in range(20):
        ranges = distances + torch.randn(distances.shape, generator=generator, dtype=torch.float64)
        rss = SETTINGS.rss_at_1_m_dbm - 10 * SETTINGS.path_loss_exponent * distances.log10()
        now = interval(0.3 * step, ranges, rss, heard)
        state, found = method.step(state, now)
    alone = nls().step(nls().init(SITE, 50), now)[1]
    errors = [(one.positions - truth).norm(dim=-1).square().mean().sqrt() for one in (found, alone)]
    assert errors[0] < 0.5 * errors[1]


def test_one_wild_range_moves_a_settled_filter_little() -> None:
    distances = torch.cdist(
        torch.tensor([[6.0, 5.0]], dtype=torch.float64), torch.tensor(CORNERS, dtype=torch.float64)
    )
    heard = torch.ones_like(distances, dtype=torch.bool)
    rss = SETTINGS.rss_at_1_m_dbm - 10 * SETTINGS.path_loss_exponent * distances.log10()
    method = RttRss()
    state = method.init(SITE, 1)
    for step in range(10):
        state, settled = method.step(state, interval(0.3 * step, distances, rss, heard))
    wild = distances.clone()
    wild[0, 2] = 500.0
    _, found = method.step(state, interval(3.0, wild, rss, heard))
    assert (found.positions - settled.positions).norm() < 0.6
