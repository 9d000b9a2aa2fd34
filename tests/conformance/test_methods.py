"""One suite over every method that needs no artifact: the interface of design §5.9."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache

import pytest
import torch

from fploc.calibration.offsets import constant_offset
from fploc.errors import UnknownNameError
from fploc.intervals import Estimate, Intervals, NoFix
from fploc.methods.bayes_grid import BayesGrid, BayesGridSettings
from fploc.methods.cbt_wccg import CbtWccg, CbtWccgSettings
from fploc.methods.interface import Examples, Filtering, Method
from fploc.methods.learned_grid import LearnedGridSettings
from fploc.methods.one_shot import Memoryless
from fploc.methods.registry import (
    GEOMETRIC_METHODS,
    SOURCE_FITTED_METHODS,
    default_calibration,
    geometric_method,
)
from fploc.methods.rtt_rss import RttRssSettings
from fploc.sites.site import AccessPoint, Site
from rooms import open_plan

PLACES = [(0.0, 0.0), (20.0, 1.0), (21.0, 15.0), (-2.0, 14.0), (9.0, 6.0), (12.0, -3.0)]
DEVICES = 7
OUTLIER_M = 500.0


def site_of(places: list[tuple[float, float]], order: list[int] | None = None) -> Site:
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", *places[index], 2.0)
            for index in (range(len(places)) if order is None else order)
        ),
        device_height_m=1.0,
    )


SITE = site_of(PLACES)


def exact_grid() -> BayesGrid:
    """Return the grid filter for ranges that are the distances but for a few centimetres."""
    exact = replace(
        BayesGridSettings.read(), bias_m=0.0, ratio_low=1.0, ratio_high=1.0, scale_low=0.02, scale_high=0.02
    )
    return BayesGrid(exact)


def single_circles() -> CbtWccg:
    """Return the method without the circles beside the ranges, which cross unevenly around the position."""
    return CbtWccg(replace(CbtWccgSettings.read(), shifts_m=(0.0,), kernel_m=0.01))


@dataclass(frozen=True)
class Promise:
    """What a method promises where solvers of one interval promise 1e-6 m from three ranges.

    Args:
        fewest_ranges: From how many ranges it has a fix.
        tolerance_m: Of its position from ranges without noise.
        without_noise: Makes it for ranges without noise; None for what the registry makes.
        fixes_on_a_line: True where access points on one line are no obstacle.
    """

    fewest_ranges: int = 3
    tolerance_m: float = 1e-6
    without_noise: Callable[[], Method] | None = None
    fixes_on_a_line: bool = False


PROMISES: Mapping[str, Promise] = {
    "bayes-grid": Promise(
        fewest_ranges=1,
        tolerance_m=BayesGridSettings.read().cell_m / 2,
        without_noise=exact_grid,
        fixes_on_a_line=True,
    ),
    "cbt-wccg": Promise(without_noise=single_circles),
    "knn": Promise(fewest_ranges=1, fixes_on_a_line=True),
    "learned-grid": Promise(
        fewest_ranges=1, tolerance_m=LearnedGridSettings.read().coarse.cell_m, fixes_on_a_line=True
    ),
}
NAMES = sorted([*GEOMETRIC_METHODS, *SOURCE_FITTED_METHODS])


def promise_of(name: str) -> Promise:
    return PROMISES.get(name, Promise())


def intervals_of(ranges: torch.Tensor, heard: torch.Tensor) -> Intervals:
    """Return intervals with these ranges, and with the signal strengths that belong to them."""
    path_loss = RttRssSettings.read()
    losses_db = 10 * path_loss.path_loss_exponent * ranges.clamp(min=0.1).log10()
    rss = path_loss.rss_at_1_m_dbm - losses_db
    return Intervals(
        t_s=torch.zeros(len(ranges), dtype=torch.float64),
        ranges=torch.where(heard, ranges, 0.0),
        stds=torch.zeros_like(ranges),
        rss=torch.where(heard, rss, 0.0),
        heard=heard,
        present=torch.ones(len(ranges), dtype=torch.bool),
    )


def some_truth(devices: int = DEVICES) -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.rand(devices, 2, generator=generator, dtype=torch.float64) * 14


def true_ranges(truth: torch.Tensor, places: list[tuple[float, float]] = PLACES) -> torch.Tensor:
    return torch.cdist(truth, torch.tensor(places, dtype=torch.float64))


def intervals() -> tuple[Intervals, torch.Tensor]:
    """Return intervals that hear 6, 2, 1, 0, 5, 6 and 6 access points, and where they were made."""
    truth = some_truth()
    heard = torch.ones(DEVICES, len(PLACES), dtype=torch.bool)
    heard[1, 2:] = False
    heard[2, 1:] = False
    heard[3] = False
    heard[4, 5] = False
    return intervals_of(true_ranges(truth), heard), truth


def located(method: Method, made: Intervals, site: Site = SITE) -> Estimate:
    found = method.step(method.init(site, len(made.t_s)), made)[1]
    check_whole(found)
    return found


def check_whole(found: Estimate) -> None:
    """Every fix has a position and a covariance; whatever has none says why."""
    for one in (found.positions, found.covariances.flatten(1)):
        assert torch.equal(torch.isfinite(one).all(-1), found.fixed)
        assert torch.equal(one.isnan().all(-1), ~found.fixed)
    assert set(found.reasons.tolist()) <= set(NoFix)
    covariances = found.covariances[found.fixed]
    torch.testing.assert_close(covariances, covariances.mT)
    assert (torch.linalg.eigvalsh(covariances) > 0).all()


@cache
def ready(name: str, site: Site = SITE) -> Method:
    """Return a method that can run at ``site``: one that learns has been where the tests go, without noise."""
    if name in GEOMETRIC_METHODS:
        return geometric_method(name)
    return SOURCE_FITTED_METHODS[name]().fitted([examples_at(site)])


def examples_at(site: Site) -> Examples:
    """Return recordings of all access points, and of those whose names the tests leave silent."""
    generator = torch.Generator().manual_seed(7)
    elsewhere = torch.rand(60, 2, generator=generator, dtype=torch.float64) * 14
    truth = torch.cat([some_truth(), elsewhere])
    ranges = torch.cdist(truth, torch.from_numpy(site.positions_m))
    heard = torch.ones_like(ranges, dtype=torch.bool)
    without_last = heard.clone()
    without_last[:, [point.name == "AP5" for point in site.access_points]] = False
    halves = [intervals_of(ranges, heard), intervals_of(ranges, without_last)]
    both = {one.name: torch.stack([getattr(half, one.name) for half in halves], 1) for one in SINGLE}
    return Examples(
        site, open_plan(site), Intervals(**both), torch.stack([truth, truth], 1), torch.tensor([1, 2])
    )


SINGLE = fields(Intervals)[:-1]


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def exact(name: str) -> Method:
    made = promise_of(name).without_noise
    return ready(name) if made is None else made()


def test_a_method_bears_its_name(name: str) -> None:
    assert ready(name).name == name


def test_a_method_names_a_calibration_to_run_with(name: str) -> None:
    constant_offset(default_calibration(name))


def test_noise_free_ranges_give_back_the_position(name: str) -> None:
    made, truth = intervals()
    found = located(exact(name), made)
    enough = made.heard.sum(-1) >= 3
    assert found.fixed[enough].all()
    errors = (found.positions - truth)[enough].norm(dim=-1)
    assert (errors <= promise_of(name).tolerance_m).all()


def test_no_fix_comes_with_its_reason(name: str) -> None:
    made, _ = intervals()
    found = located(ready(name), made)
    counts = made.heard.sum(-1)
    assert torch.equal(found.fixed, counts >= promise_of(name).fewest_ranges)
    assert (found.reasons[counts == 0] == NoFix.NO_READING).all()
    assert (found.reasons[(counts > 0) & ~found.fixed] == NoFix.TOO_FEW_RANGES).all()


def test_nothing_heard_by_anybody_is_no_fix(name: str) -> None:
    made, _ = intervals()
    found = located(ready(name), intervals_of(made.ranges, torch.zeros_like(made.heard)))
    assert (found.reasons == NoFix.NO_READING).all()


def test_access_points_on_one_line_fix_nothing_alone(name: str) -> None:
    places = [(0.0, 1.0), (6.0, 4.0), (12.0, 7.0), (20.0, 11.0)]
    ranges = true_ranges(some_truth(), places)
    found = located(
        ready(name, site_of(places)), intervals_of(ranges, torch.ones_like(ranges).bool()), site_of(places)
    )
    expected = NoFix.FIXED if promise_of(name).fixes_on_a_line else NoFix.DEGENERATE_GEOMETRY
    assert (found.reasons == expected).all()


def test_an_access_point_that_stands_there_twice_changes_nothing_without_noise(name: str) -> None:
    places = [*PLACES, PLACES[0], PLACES[4]]
    truth = some_truth()
    ranges = true_ranges(truth, places)
    method = exact(name) if name in GEOMETRIC_METHODS else ready(name, site_of(places))
    found = located(method, intervals_of(ranges, torch.ones_like(ranges).bool()), site_of(places))
    assert ((found.positions - truth).norm(dim=-1) <= promise_of(name).tolerance_m).all()


def test_two_places_are_one_too_few(name: str) -> None:
    places = [PLACES[0], PLACES[0], PLACES[1], PLACES[1]]
    ranges = true_ranges(some_truth(), places)
    found = located(
        ready(name, site_of(places)), intervals_of(ranges, torch.ones_like(ranges).bool()), site_of(places)
    )
    assert found.fixed.all() if promise_of(name).fixes_on_a_line else not found.fixed.any()


@pytest.mark.parametrize("count", [1, 2])
def test_a_site_of_too_few_access_points_has_no_fix_but_no_failure(count: int, name: str) -> None:
    places = PLACES[:count]
    ranges = true_ranges(some_truth(), places)
    heard = torch.ones_like(ranges).bool()
    heard[3] = False
    found = located(ready(name, site_of(places)), intervals_of(ranges, heard), site_of(places))
    enough = heard.sum(-1) >= promise_of(name).fewest_ranges
    assert torch.equal(found.fixed, enough)


@pytest.mark.parametrize("column", range(len(PLACES)))
def test_a_range_of_500_m_gives_whole_fixes_or_none(column: int, name: str) -> None:
    ranges = true_ranges(some_truth())
    ranges[:, column] = OUTLIER_M
    located(ready(name), intervals_of(ranges, torch.ones_like(ranges).bool()))


def test_hostile_ranges_give_whole_fixes_or_none(name: str) -> None:
    generator = torch.Generator().manual_seed(9)
    ranges = torch.rand(300, len(PLACES), generator=generator, dtype=torch.float64) ** 6 * 600
    heard = torch.rand(300, len(PLACES), generator=generator) < 0.7
    heard[7] = False
    found = located(ready(name), intervals_of(ranges, heard))
    assert found.fixed.any() and not found.fixed.all()


def test_the_order_of_access_points_changes_nothing(name: str) -> None:
    made, _ = intervals()
    made = replace(made, ranges=torch.where(made.heard, made.ranges + 0.7, 0.0))
    order = [4, 2, 0, 5, 1, 3]
    site = site_of(PLACES, order)
    turned = replace(made, ranges=made.ranges[:, order], heard=made.heard[:, order], rss=made.rss[:, order])
    one, other = located(ready(name), made), located(ready(name, site), turned, site)
    torch.testing.assert_close(one.positions, other.positions, atol=1e-6, rtol=0, equal_nan=True)


def test_the_order_of_devices_changes_nothing(name: str) -> None:
    method = ready(name)
    made, _ = intervals()
    turned = replace(made, **{one.name: getattr(made, one.name).flip(0) for one in SINGLE})
    one, other = located(method, made), located(method, turned)
    torch.testing.assert_close(one.positions.flip(0), other.positions, atol=1e-9, rtol=0, equal_nan=True)


def test_absent_devices_keep_their_state(name: str) -> None:
    method = ready(name)
    made, _ = intervals()
    later = replace(made, t_s=made.t_s + 0.4, ranges=made.ranges + 0.3 * made.heard)
    present = torch.arange(DEVICES) % 2 == 0
    state, _ = method.step(method.init(SITE, DEVICES), made)
    paused, _ = method.step(state, replace(later, present=present))
    last = replace(later, t_s=made.t_s + 0.9)
    after_pause, without = method.step(paused, last)[1], method.step(state, last)[1]
    torch.testing.assert_close(after_pause.positions[~present], without.positions[~present], equal_nan=True)


def test_a_method_steps_through_time_without_a_gap(name: str) -> None:
    method = exact(name)
    state = method.init(SITE, DEVICES)
    made, truth = intervals()
    for step in range(12):
        moved = truth + 0.02 * step
        now = intervals_of(true_ranges(moved), made.heard)
        state, found = method.step(state, replace(now, t_s=now.t_s + 0.3 * step))
        check_whole(found)
    assert torch.equal(found.fixed, made.heard.sum(-1) >= promise_of(name).fewest_ranges)


def test_a_method_without_memory_returns_its_state_unchanged(name: str) -> None:
    method = ready(name)
    state = method.init(SITE, DEVICES)
    after, _ = method.step(state, intervals()[0])
    assert (after is state) == isinstance(method, Memoryless)


FILTERS = [name for name in GEOMETRIC_METHODS if isinstance(geometric_method(name), Filtering)]


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_takes_the_speed_that_is_asked_for(name: str) -> None:
    method = geometric_method(name)
    assert isinstance(method, Filtering)
    slow, fast = (method.for_speed(speed) for speed in (0.1, 3.0))
    made, _ = intervals()
    later = replace(made, t_s=made.t_s + 1.0, heard=torch.zeros_like(made.heard))
    again = replace(made, t_s=made.t_s + 2.0)
    spreads = []
    for one in (slow, fast):
        state, _ = one.step(one.init(SITE, DEVICES), made)
        state, _ = one.step(state, later)
        spreads.append(one.step(state, again)[1].covariances[0].trace())
    assert spreads[0] < spreads[1]


def test_an_unknown_method_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=f"'magic', expected one of {', '.join(GEOMETRIC_METHODS)}"):
        geometric_method("magic")
