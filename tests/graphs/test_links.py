from __future__ import annotations

import torch

from fploc.intervals import Intervals, links_of


def test_links_stand_in_the_order_of_the_mask() -> None:
    """So that ``masked_scatter`` by the mask puts a value per link back where it came from."""
    random = torch.Generator().manual_seed(0)
    ranges, rss = 30 * torch.rand(5, 7, generator=random), -90 * torch.rand(5, 7, generator=random)
    heard = torch.rand(5, 7, generator=random) < 0.5
    access_points = torch.rand(7, 2, generator=random)
    links = links_of(
        Intervals(
            t_s=torch.zeros(5, dtype=torch.float64),
            ranges=ranges,
            stds=torch.zeros(5, 7),
            rss=rss,
            heard=heard,
            present=torch.ones(5, dtype=torch.bool),
        ),
        access_points,
    )
    assert torch.equal(links.ranges, ranges[heard]) and torch.equal(links.rss, rss[heard])
    assert torch.equal(links.device, torch.arange(5)[:, None].expand(5, 7)[heard])
    assert torch.equal(links.access_points, access_points.expand(5, 7, 2)[heard])
    restored = torch.zeros_like(ranges).masked_scatter(heard, links.ranges)
    assert torch.equal(restored, ranges * heard)
