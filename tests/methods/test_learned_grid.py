from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from fploc.errors import FplocError
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.sight import behind_walls
from fploc.intervals import Estimate, Intervals, NoFix
from fploc.methods.coarse_belief import CoarseBelief, CoarseState
from fploc.methods.interface import Examples, Filtering, ReadsPlan, Smoothing, SourceFitted
from fploc.methods.learned_grid import LearnedGrid, LearnedGridFilter, LearnedGridSettings
from fploc.methods.link_evidence import VIEWS
from rooms import open_plan, room

CORNERS = [(0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0), (4.0, 3.0)]
SITE = room(CORNERS)
READ = LearnedGridSettings.read()
SETTINGS = replace(
    READ,
    coarse=replace(READ.coarse, margin_m=2.0),
    lessons=replace(READ.lessons, learn_every=1, rows=4, hidden=16, fewest_steps=150),
)
FAINT_DBM, EXCESS_M = -85.0, 3.0
OPEN = open_plan(SITE)
ONE = torch.ones(2, dtype=torch.int64)
"""Both walks are of one device."""


def interval(positions: torch.Tensor, excess_m: torch.Tensor | None = None, t_s: float = 0.0) -> Intervals:
    """Return what devices at positions (B, 2) hear; links with an excess (B, A) are faint."""
    distances = torch.cdist(positions, torch.tensor(CORNERS, dtype=torch.float64))
    excess = torch.zeros_like(distances) if excess_m is None else excess_m
    rss = torch.where(excess > 0, FAINT_DBM, -40 - 20 * distances.clamp(min=1.0).log10())
    return Intervals(
        t_s=torch.full((len(positions),), t_s, dtype=torch.float64),
        ranges=distances + excess,
        stds=torch.full_like(distances, 0.1),
        rss=rss,
        heard=torch.ones_like(distances, dtype=torch.bool),
        present=torch.ones(len(positions), dtype=torch.bool),
    )


def walked(seed: int, *, labelled: bool = True) -> Examples:
    """Return two walks of 80 s in which one link in three is faint and 3 m too long for 8 s at a time."""
    generator = torch.Generator().manual_seed(seed)
    turns = torch.rand(2, 1, 2, generator=generator, dtype=torch.float64) * 6
    phase = torch.arange(200, dtype=torch.float64)[None, :, None] * 0.02 + turns
    truth = torch.cat([4 + 3.5 * phase[..., :1].cos(), 3 + 2.5 * phase[..., 1:].sin()], -1)
    walled = torch.rand(10, 2, len(CORNERS), generator=generator).repeat_interleave(20, 0) < 1 / 3
    rows = [interval(truth[:, k], EXCESS_M * walled[k], t_s=0.4 * k) for k in range(200)]
    names = ("t_s", "ranges", "stds", "rss", "heard", "present")
    intervals = Intervals(**{name: torch.stack([getattr(row, name) for row in rows]) for name in names})
    labels = truth.transpose(0, 1)
    return Examples(SITE, OPEN, intervals, labels if labelled else torch.full_like(labels, torch.nan), ONE)


@cache
def learned() -> LearnedGridFilter:
    return LearnedGrid(SETTINGS).fitted([walked(1)])


def followed(method: LearnedGridFilter, examples: Examples) -> tuple[torch.Tensor, Estimate]:
    """Return the errors of every interval, shape (T, B), and the last estimate."""
    state = method.init(SITE, examples.labels.shape[1])
    errors = []
    for step in range(len(examples.labels)):
        state, found = method.step(state, examples.intervals.at(step))
        errors.append((found.positions - examples.labels[step]).norm(dim=-1))
    return torch.stack(errors), found


def walled_plan(blocked_from_x_m: float) -> FloorPlan:
    """Return a plan of the box and 2 m around it, solid on the right of a line."""
    walls = OPEN.walls.copy()
    walls[:, round((blocked_from_x_m + 2) * 10) :] = True
    return replace(OPEN, walls=walls)


def test_it_learns_from_sources_filters_itself_and_reads_plans() -> None:
    assert isinstance(LearnedGrid(), SourceFitted) and not LearnedGrid().learns_places
    assert isinstance(learned(), Filtering)
    assert isinstance(learned(), ReadsPlan)
    assert isinstance(learned(), Smoothing)


def followed_coarsely(examples: Examples) -> torch.Tensor:
    """Return the errors of the coarse belief alone, shape (T, B)."""
    belief = CoarseBelief(SETTINGS.coarse)
    state = CoarseState.before(belief.grid(SITE), belief.walk, examples.labels.shape[1])
    errors = []
    for step in range(len(examples.labels)):
        state, _ = belief.step(state, examples.intervals.at(step))
        means, _ = state.window.moments(state.beliefs.sum(1).double())
        errors.append((means - examples.labels[step]).norm(dim=-1))
    return torch.stack(errors)


def test_what_was_learned_beats_the_coarse_belief_on_a_walk_not_seen() -> None:
    errors, last = followed(learned(), walked(2))
    coarse = followed_coarsely(walked(2))
    assert last.fixed.all()
    assert errors[20:].square().mean() < 0.8 * coarse[20:].square().mean()


def third_too_long(place: torch.Tensor, excess_m: float) -> Intervals:
    """Return what is heard at a place, one range too long; its signal strength says nothing of it."""
    made = interval(place, torch.tensor([[0.0, 0.0, excess_m, 0.0, 0.0]], dtype=torch.float64))
    return replace(made, rss=interval(place).rss)


def test_what_a_bias_leaves_is_forgiven_where_a_range_is_too_long() -> None:
    """Of one link's error, 2 m more cost less than 2 m less."""
    method = LearnedGridFilter(SETTINGS.sharing(0.0), learned().networks)
    place = torch.tensor([[3.0, 2.0]], dtype=torch.float64)
    found = {}
    for excess_m in (-2.0, 0.0, 2.0):
        made = third_too_long(place, excess_m)
        found[excess_m] = method.step(method.init(SITE, 1), made)[1].positions[0]
    shorter, longer = ((found[one] - found[0.0]).norm() for one in (-2.0, 2.0))
    assert longer < 0.5 * shorter


def test_the_stated_regions_hold_most_truths() -> None:
    method, held = learned(), []
    for seed in (3, 4):
        examples, state = walked(seed), method.init(SITE, 2)
        for step in range(len(examples.labels)):
            state, found = method.step(state, examples.intervals.at(step))
            away = (found.positions - examples.labels[step])[..., None]
            held.append((away.mT @ torch.linalg.solve(found.covariances, away))[:, 0, 0] < 5.99)
    assert torch.stack(held).double().mean() > 0.9


def test_who_knows_the_end_errs_less_and_at_the_end_the_same() -> None:
    examples = walked(2)
    causal, last = followed(learned(), examples)
    forward, smoothed = learned().both_ways(SITE, examples.intervals)
    torch.testing.assert_close((forward.positions - examples.labels).norm(dim=-1), causal, atol=0, rtol=0)
    errors = (smoothed.positions - examples.labels).norm(dim=-1)
    assert smoothed.fixed.all() and errors.shape == causal.shape
    assert errors.square().mean() < 0.7 * causal.square().mean()
    torch.testing.assert_close(smoothed.positions[-1], last.positions, atol=1e-2, rtol=0)


def test_a_smoothed_start_knows_what_one_reading_could_not() -> None:
    examples = walked(2)
    one = torch.arange(len(CORNERS)) == 0
    heard = examples.intervals.heard.clone()
    heard[:5] &= one
    intervals = replace(examples.intervals, heard=heard)
    causal, _ = followed(learned(), replace(examples, intervals=intervals))
    _, smoothed = learned().both_ways(SITE, intervals)
    errors = (smoothed.positions - examples.labels).norm(dim=-1)
    assert errors[0].mean() < 0.5 * causal[0].mean()


def test_the_same_seed_learns_the_same_network() -> None:
    again = LearnedGrid(SETTINGS).fitted([walked(1)])
    made = interval(torch.tensor([[2.0, 2.5]], dtype=torch.float64))
    one, other = (method.step(method.init(SITE, 1), made)[1] for method in (learned(), again))
    assert torch.equal(one.positions, other.positions)
    state = torch.random.get_rng_state()
    LearnedGrid(SETTINGS).fitted([walked(1)])
    assert torch.equal(state, torch.random.get_rng_state())


def test_a_batch_is_the_devices_one_by_one() -> None:
    places = torch.tensor([[1.0, 1.0], [7.0, 5.0], [4.0, 2.0]], dtype=torch.float64)
    method = learned()
    state, alone = method.init(SITE, 3), [method.init(SITE, 1) for _ in places]
    for step in range(4):
        made = interval(places + 0.1 * step, t_s=0.4 * step)
        state, together = method.step(state, made)
        for device, one in enumerate(alone):
            own = interval(places[device : device + 1] + 0.1 * step, t_s=0.4 * step)
            alone[device], found = method.step(one, own)
            torch.testing.assert_close(found.positions[0], together.positions[device], atol=1e-6, rtol=0)


def test_a_kept_state_goes_on_where_it_was() -> None:
    method, place = learned(), torch.tensor([[5.0, 4.0]], dtype=torch.float64)
    state = method.init(SITE, 1)
    for step in range(3):
        state, _ = method.step(state, interval(place, t_s=0.4 * step))
    later = interval(place + 0.2, t_s=1.6)
    one, other = method.step(state, later)[1], method.step(state, later)[1]
    assert torch.equal(one.positions, other.positions)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_access_points_make_a_wide_region_or_no_fix(count: int) -> None:
    method, place = learned(), torch.tensor([[2.0, 2.0]], dtype=torch.float64)
    whole = interval(place)
    few = replace(whole, heard=torch.arange(len(CORNERS))[None] < count)
    _, found = method.step(method.init(SITE, 1), few)
    _, sure = method.step(method.init(SITE, 1), whole)
    assert found.reasons.tolist() == [NoFix.NO_READING if count == 0 else NoFix.FIXED]
    if count:
        assert found.covariances[0].trace() > 2 * sure.covariances[0].trace()


def test_silence_widens_the_region() -> None:
    method, place = learned(), torch.tensor([[2.0, 2.0]], dtype=torch.float64)
    state, _ = method.step(method.init(SITE, 1), interval(place))
    soon = method.step(state, replace(interval(place, t_s=0.1), heard=torch.arange(5)[None] == 0))[1]
    late = method.step(state, replace(interval(place, t_s=20.0), heard=torch.arange(5)[None] == 0))[1]
    assert late.covariances[0].trace() > soon.covariances[0].trace()


def walker_errors(speed_mps: float) -> torch.Tensor:
    """Return the errors for somebody who crosses the box and turns back, shape (T,), metres."""
    crossed = torch.arange(0.0, 14.0, 0.4 * speed_mps, dtype=torch.float64)
    xs = torch.where(crossed < 7.0, 0.5 + crossed, 14.5 - crossed)
    path = torch.stack([xs, torch.full_like(xs, 2.0)], -1)
    method = learned()
    state, errors = method.init(SITE, 1), []
    for step, place in enumerate(path):
        state, found = method.step(state, interval(place[None], t_s=0.4 * step))
        errors.append((found.positions[0] - place).norm())
    return torch.stack(errors)


@pytest.mark.parametrize("speed_mps", [0.07, 0.7])
def test_who_crawls_and_who_walks_is_followed(speed_mps: float) -> None:
    assert walker_errors(speed_mps)[5:].square().mean().sqrt() < 0.35


def test_nobody_is_put_into_a_wall() -> None:
    method = learned()
    at_the_wall = torch.tensor([[4.9, 1.5]], dtype=torch.float64)
    made = interval(at_the_wall, torch.full((1, len(CORNERS)), 0.4, dtype=torch.float64))
    made = replace(made, rss=interval(at_the_wall).rss)
    free = method.step(method.init(SITE, 1), made)[1].positions[0, 0]
    walled = method.for_plan(walled_plan(blocked_from_x_m=5.0))
    beside = walled.step(walled.init(SITE, 1), made)[1].positions[0, 0]
    assert beside < free
    assert (beside - 4.9).abs() < 1.0


def divided(opening_m: float) -> FloorPlan:
    """Return a plan with a wall of 0.2 m across the box at x = 4 m, but for an opening at the top."""
    walls = OPEN.walls.copy()
    walls[round(opening_m * 10) :, 59:61] = True
    return replace(OPEN, walls=walls)


def walled_walks(seed: int) -> Examples:
    """Return walks in which ranges through the wall, and no others, are 3 m too long; nothing else tells them."""
    examples = walked(seed)
    distances = torch.cdist(examples.labels, torch.tensor(CORNERS, dtype=torch.float64))
    walled = behind_walls(divided(1.0), np.array(CORNERS), examples.labels[:, :, None].numpy())
    ranges = distances + EXCESS_M * torch.from_numpy(walled)
    alike = torch.full_like(distances, -60.0)
    return replace(
        examples, plan=divided(1.0), intervals=replace(examples.intervals, ranges=ranges, rss=alike)
    )


def test_the_plan_tells_which_ranges_come_through_walls() -> None:
    method, examples = LearnedGrid(SETTINGS).fitted([walled_walks(1)]), walled_walks(2)
    squares = {
        name: followed(ready, examples)[0][20:].square().mean()
        for name, ready in (("none", method), ("real", method.for_plan(divided(1.0))))
    }
    assert squares["real"] < 0.8 * squares["none"]


def test_of_walls_that_no_source_has_nothing_is_said() -> None:
    networks = learned().networks
    assert [network.sights for network in networks] == [1] * len(VIEWS)
    networks = LearnedGrid(SETTINGS).fitted([walled_walks(1)]).networks
    assert [network.sights for network in networks] == [view.sights for view in VIEWS]
    made = interval(torch.tensor([[2.0, 2.5]], dtype=torch.float64))
    alike = LearnedGridFilter(replace(SETTINGS, walled=SETTINGS.clear), learned().networks)
    through, open_ = (alike.for_plan(plan) for plan in (divided(1.0), OPEN))
    one, other = (method.step(method.init(SITE, 1), made)[1] for method in (through, open_))
    assert (one.positions - other.positions).norm() < 0.1


def test_behind_walls_a_range_that_is_too_long_moves_less() -> None:
    """Of three ranges one comes from beyond the wall."""
    place = torch.tensor([[2.0, 2.5]], dtype=torch.float64)
    heard = torch.tensor([[True, False, True, True, False]])
    moved_m = []
    for plan in (divided(1.0), OPEN):
        method = learned().for_plan(plan)
        found = []
        for excess_m in (0.0, 2.0):
            made = replace(third_too_long(place, excess_m), heard=heard)
            found.append(method.step(method.init(SITE, 1), made)[1].positions[0])
        moved_m.append((found[1] - found[0]).norm())
    through, open_ = moved_m
    assert through < 0.7 * open_


def test_a_source_without_a_plan_is_named() -> None:
    with pytest.raises(FplocError, match="floor plan of box: found none, expected a plan with walls"):
        LearnedGrid(SETTINGS).fitted([replace(walked(1), plan=None)])


def test_a_speed_is_taken() -> None:
    assert learned().for_speed(1.4).settings.coarse.walk.speed_prior_mps == 1.4
    assert learned().for_plan(walled_plan(5.0)).for_speed(1.4).settings == learned().for_speed(1.4).settings


def test_without_ground_truth_it_says_what_is_missing() -> None:
    with pytest.raises(FplocError, match="--method learned-grid: found no labelled reading"):
        LearnedGrid(SETTINGS).fitted([walked(1, labelled=False)])
