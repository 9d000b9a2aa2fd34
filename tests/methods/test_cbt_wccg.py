from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import torch

from fploc.intervals import Intervals, NoFix
from fploc.methods.cbt_wccg import CbtWccg, CbtWccgSettings, heaviest_cells
from rooms import room

CORNERS = [(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0), (8.0, 18.0)]
SITE = room(CORNERS)
SETTINGS = CbtWccgSettings.read()
TRUTH = torch.tensor([[6.0, 5.0], [15.2, 9.1], [2.3, 12.0]], dtype=torch.float64)


def interval(ranges: torch.Tensor) -> Intervals:
    return Intervals(
        t_s=torch.zeros(len(ranges)),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=torch.zeros_like(ranges),
        heard=ranges > 0,
        present=torch.ones(len(ranges), dtype=torch.bool),
    )


def true_ranges() -> torch.Tensor:
    return torch.cdist(TRUTH, torch.tensor(CORNERS, dtype=torch.float64))


def crossings(
    one: tuple[float, float], r_1: float, two: tuple[float, float], r_2: float
) -> list[tuple[float, float]]:
    """Two circles' intersections by trigonometry."""
    gap = math.dist(one, two)
    if r_1 <= 0 or r_2 <= 0 or gap > r_1 + r_2 or gap < abs(r_1 - r_2):
        return []
    bearing = math.atan2(two[1] - one[1], two[0] - one[0])
    opening = math.acos((r_1**2 + gap**2 - r_2**2) / (2 * r_1 * gap))
    return [
        (one[0] + r_1 * math.cos(bearing + turn), one[1] + r_1 * math.sin(bearing + turn))
        for turn in (opening, -opening)
    ]


def by_hand(ranges: list[float]) -> np.ndarray:
    """The reading of rivals.md, point by point."""
    points, weights = [], []
    for first, second in itertools.combinations(range(len(ranges)), 2):
        for shift_1, shift_2 in itertools.product(SETTINGS.shifts_m, repeat=2):
            r_1, r_2 = ranges[first] + shift_1, ranges[second] + shift_2
            weight = math.exp(-(shift_1**2 + shift_2**2) / (2 * SETTINGS.shift_sd_m**2))
            for point in crossings(CORNERS[first], r_1, CORNERS[second], r_2):
                points.append(point)
                weights.append(weight / math.sqrt(r_1 * r_2))
    cells = defaultdict(list)
    for index, (x, y) in enumerate(points):
        cells[math.floor(x / SETTINGS.cell_m), math.floor(y / SETTINGS.cell_m)].append(index)
    heaviest = max(cells.values(), key=lambda members: sum(weights[index] for index in members))
    places, masses = np.array(points), np.array(weights)
    centre = np.average(places[heaviest], axis=0, weights=masses[heaviest])
    for _ in range(SETTINGS.mean_shift_steps):
        kernel = np.exp(-np.square(places - centre).sum(1) / (2 * SETTINGS.kernel_m**2))
        centre = np.average(places, axis=0, weights=masses * kernel)
    return centre


def test_it_is_the_reading_of_the_source_point_by_point() -> None:
    generator = torch.Generator().manual_seed(3)
    noise = torch.rand(len(TRUTH), len(CORNERS), generator=generator, dtype=torch.float64) * 2.0
    ranges = true_ranges() + noise
    method = CbtWccg()
    _, found = method.step(method.init(SITE, len(TRUTH)), interval(ranges))
    expected = np.array([by_hand(row) for row in ranges.tolist()])
    np.testing.assert_allclose(found.positions.numpy(), expected, atol=1e-9)


def test_ranges_without_noise_come_back_within_decimetres() -> None:
    method = CbtWccg()
    _, found = method.step(method.init(SITE, len(TRUTH)), interval(true_ranges()))
    assert ((found.positions - TRUTH).norm(dim=-1) < 0.3).all()


def test_circles_that_do_not_cross_alone_cross_with_their_neighbours() -> None:
    short = torch.tensor([[9.6, 9.6, 0.0, 5.0, 0.0]], dtype=torch.float64)
    alone = CbtWccg(replace(SETTINGS, shifts_m=(0.0,)))
    state = alone.init(SITE, 1)
    assert alone.step(state, interval(short))[1].reasons.tolist() == [NoFix.DEGENERATE_GEOMETRY]
    assert CbtWccg().step(state, interval(short))[1].fixed.all()


def test_the_heaviest_cell_is_found_among_light_and_weightless_ones() -> None:
    points = torch.tensor(
        [[[0.1, 0.1], [0.2, 0.4], [5.0, 5.0], [-3.1, 2.0], [5.1, 5.2], [0.3, 0.1]]], dtype=torch.float64
    )
    weights = torch.tensor([[1.0, 1.0, 1.2, 0.0, 1.2, 0.0]], dtype=torch.float64)
    found = heaviest_cells(points, weights, 0.75)
    torch.testing.assert_close(found, torch.tensor([[5.05, 5.1]], dtype=torch.float64))
    assert heaviest_cells(points, torch.zeros_like(weights), 0.75).isnan().all()


def test_points_in_cells_left_of_the_origin_are_told_apart() -> None:
    points = torch.tensor([[[-0.1, 0.1], [0.1, -0.1], [0.1, 0.1], [0.2, 0.2]]], dtype=torch.float64)
    weights = torch.tensor([[1.0, 1.0, 0.8, 0.8]], dtype=torch.float64)
    found = heaviest_cells(points, weights, 0.75)
    torch.testing.assert_close(found, torch.tensor([[0.15, 0.15]], dtype=torch.float64))
