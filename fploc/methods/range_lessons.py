"""What the networks of ``learned-grid`` learn from, and its training.

Axes: T intervals, B recordings and copies of them, A access points, F features, S kinds of sight.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.errors import FplocError
from fploc.floorplan.sight import behind_walls
from fploc.intervals import Intervals
from fploc.methods.coarse_belief import CoarseBelief, CoarseState
from fploc.methods.interface import Examples
from fploc.methods.link_evidence import FEATURES, View
from fploc.models.range_error import RangeErrorNetwork, log_density
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site

EVERY_S = 60.0
"""Copies of a recording lose other access points, and get another offset, every minute."""
BATCH = 1024


@dataclass(frozen=True)
class LessonSettings:
    """Settings of the network and its training.

    Args:
        learn_every: Of so many intervals of a recording one is learned from: neighbours are nearly the same.
        rows: Recordings and copies of each site together, at least: as many copies are made as it takes.
        fewest_kept: So many access points a copy keeps at least, where there are as many.
        offset_m: Standard deviation of the offset of a copy, metres.
        pace: Every other copy is so many times as fast as the recording: the sources' robots crawl.
        hidden: Width of the network.
        dropout: Of its first layer.
        epochs: Passes over all readings.
        fewest_steps: Gradient steps at least.
        learning_rate: At its highest.
        weight_decay: Of AdamW.
        seed: Of copies, weights and batches.
    """

    learn_every: int
    rows: int
    fewest_kept: int
    offset_m: float
    pace: float
    hidden: int
    dropout: float
    epochs: int
    fewest_steps: int
    learning_rate: float
    weight_decay: float
    seed: int


@dataclass(frozen=True)
class Lessons:
    """Readings of one site with ground truth.

    Args:
        site: Where they were made.
        devices: Device of each, shape (n,).
        features: Shape (n, F).
        sights: 1 where walls stand between, 0 where not, shape (n,).
        errors_m: Range minus distance, shape (n,), metres.
    """

    site: Site
    devices: Tensor
    features: Tensor
    sights: Tensor
    errors_m: Tensor


@torch.no_grad()
def range_lessons(examples: Examples, coarse: CoarseBelief, settings: LessonSettings) -> Lessons:
    """Return the labelled readings of a site's recordings and of copies of them, with their links' past.

    Raises:
        FplocError: If the site has no plan.
    """
    plan = examples.plan
    if plan is None:
        raise FplocError(
            f"floor plan of {examples.site.name}",
            value="none",
            expected="a plan with walls, so that ranges along clear lines teach apart from those behind walls",
            way_out="build the site with its plan, or choose another method",
        )
    examples = _in_order_of_names(examples)
    intervals, labels = copied(examples, settings)
    steps, rows, access_points = intervals.ranges.shape
    state = CoarseState.before(coarse.grid(examples.site), coarse.walk, rows)
    features = torch.zeros(steps, rows, access_points, len(FEATURES), dtype=torch.float64)
    for step in range(steps):
        state, heard = coarse.step(state, intervals.at(step))
        features[step] = heard.features
    positions_m = torch.from_numpy(examples.site.positions_m)
    errors_m = intervals.ranges - (labels[:, :, None, :] - positions_m).norm(dim=-1)
    usable = intervals.heard & intervals.present[..., None] & errors_m.isfinite()
    usable &= intervals.ranges <= FARTHEST_RANGE_M
    step, row, access_point = usable.nonzero(as_tuple=True)
    walled = behind_walls(plan, positions_m[access_point].numpy(), labels[step, row].numpy())
    devices = examples.devices.repeat(rows // len(examples.devices)).expand(steps, rows)
    return Lessons(
        examples.site,
        devices[..., None].expand_as(usable)[usable],
        features[usable],
        torch.from_numpy(walled).long(),
        errors_m[usable],
    )


def copied(examples: Examples, settings: LessonSettings) -> tuple[Intervals, Tensor]:
    """Return every ``learn_every``-th interval of all recordings, and copies behind them, with their labels.

    In copies, other access points are silent and another offset is added every minute of the recording, and
    time goes faster in every other one; recordings themselves stay as they are.
    """
    generator = torch.Generator().manual_seed(settings.seed)
    every = examples.intervals
    recordings = every.ranges.shape[1]
    copies = math.ceil(settings.rows / recordings)
    kept = slice(None, None, settings.learn_every)

    def repeated(values: Tensor) -> Tensor:
        return torch.cat([values[kept]] * copies, dim=1)

    t_s, heard = repeated(every.t_s), repeated(every.heard)
    access_points = heard.shape[-1]
    minutes = (t_s / EVERY_S).clamp(min=0).long()
    shape = (int(minutes.max()) + 1, t_s.shape[1])
    fewest = min(settings.fewest_kept, access_points)
    counts = torch.randint(fewest, access_points + 1, shape, generator=generator)
    order = torch.rand(*shape, access_points, generator=generator).argsort(-1).argsort(-1)
    audible = order < counts[..., None]
    offsets = settings.offset_m * torch.randn(shape, generator=generator, dtype=torch.float64)
    audible[:, :recordings], offsets[:, :recordings] = True, 0.0
    column = torch.arange(shape[1])
    hurried = column // recordings % 2 == 1
    heard = heard & audible[minutes, column]
    ranges = (repeated(every.ranges).double() + offsets[minutes, column][..., None]).clamp(min=0.0)
    intervals = Intervals(
        t_s=torch.where(hurried, t_s / settings.pace, t_s),
        ranges=torch.where(heard, ranges, 0.0),
        stds=repeated(every.stds),
        rss=repeated(every.rss),
        heard=heard,
        present=repeated(every.present),
    )
    return intervals, repeated(examples.labels)


def _in_order_of_names(examples: Examples) -> Examples:
    """Return the same with access points in the order of their MACs: what is drawn does not hang on theirs."""
    site, intervals = examples.site, examples.intervals
    order = sorted(range(len(site.macs)), key=site.macs.__getitem__)
    return replace(
        examples,
        site=replace(site, access_points=tuple(site.access_points[index] for index in order)),
        intervals=replace(
            intervals,
            ranges=intervals.ranges[..., order],
            stds=intervals.stds[..., order],
            rss=intervals.rss[..., order],
            heard=intervals.heard[..., order],
        ),
    )


def balanced_weights(sites: Sequence[Lessons]) -> Tensor:
    """Return the weight of every reading of all sites, shape (n,), with mean 1.

    Places weigh alike, then the sites of a place, then the devices of a site: access points that stand in four
    layouts on one floor teach no more of other floors than those of one.
    """
    places = Counter(one.site.place for one in sites)
    weights = []
    for one in sites:
        devices, which, counts = one.devices.unique(return_inverse=True, return_counts=True)
        shares = 1 / (len(places) * places[one.site.place] * len(devices) * counts.double())
        weights.append(shares[which])
    joined = torch.cat(weights)
    return joined * len(joined)


def taught(sites: Sequence[Lessons], view: View, settings: LessonSettings) -> RangeErrorNetwork:
    """Return a network trained on the readings of sites, balanced by place and device.

    Args:
        sites: At least one, each with readings.
        view: What it is shown.
        settings: Of the training.
    """
    weights = balanced_weights(sites)
    features = torch.cat([one.features for one in sites])
    sights = torch.cat([one.sights for one in sites])
    errors_m = torch.cat([one.errors_m for one in sites])
    generator = torch.Generator().manual_seed(settings.seed)
    # Nothing can be learned of walls where none were met, nor of clear lines where all were walled.
    told_apart = min(view.sights, len(sights.unique()))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = RangeErrorNetwork(view.features, told_apart, settings.hidden, settings.dropout).train()
        network.scale_by(features, weights)
        network.expect(sights, weights)
        kinds = network.told_apart(sights)
        batch = min(BATCH, len(errors_m))
        steps = max(settings.fewest_steps, settings.epochs * len(errors_m) // batch)
        optimizer = torch.optim.AdamW(
            network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, settings.learning_rate, total_steps=steps)
        for _ in range(steps):
            drawn = torch.randint(len(errors_m), (batch,), generator=generator)
            raw = network(features[drawn])[torch.arange(batch), kinds[drawn]]
            densities = log_density(raw, errors_m[drawn, None])[:, 0]
            optimizer.zero_grad()
            (-(weights[drawn] * densities).mean()).backward()
            optimizer.step()
            schedule.step()
    return network.eval().requires_grad_(False)
