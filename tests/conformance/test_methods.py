"""One suite over every method that needs no training: the interface of design §5.9."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from fploc.errors import UnknownNameError
from fploc.intervals import Intervals, NoFix
from fploc.methods.one_shot import Memoryless
from fploc.methods.registry import GEOMETRIC_METHODS, geometric_method
from fploc.sites.site import AccessPoint, Site

PLACES = [(0.0, 0.0), (20.0, 1.0), (21.0, 15.0), (-2.0, 14.0), (9.0, 6.0), (12.0, -3.0)]
DEVICES = 7


def site_of(order: list[int]) -> Site:
    return Site(
        name="box",
        place="box",
        access_points=tuple(
            AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", *PLACES[index], 2.0) for index in order
        ),
        device_height_m=1.0,
    )


SITE = site_of(list(range(len(PLACES))))


def intervals() -> tuple[Intervals, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    truth = torch.rand(DEVICES, 2, generator=generator, dtype=torch.float64) * 14
    ranges = torch.cdist(truth, torch.tensor(PLACES, dtype=torch.float64))
    heard = torch.ones(DEVICES, len(PLACES), dtype=torch.bool)
    heard[1, 2:] = False
    heard[2, 1:] = False
    heard[3] = False
    heard[4, 5] = False
    made = Intervals(
        t_s=torch.zeros(DEVICES, dtype=torch.float64),
        ranges=torch.where(heard, ranges, 0.0),
        stds=torch.zeros_like(ranges),
        rss=torch.where(heard, -60.0, 0.0).double(),
        heard=heard,
        present=torch.ones(DEVICES, dtype=torch.bool),
    )
    return made, truth


@pytest.fixture(params=sorted(GEOMETRIC_METHODS))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_method_bears_its_name(name: str) -> None:
    assert geometric_method(name).name == name


def test_noise_free_ranges_give_back_the_position(name: str) -> None:
    method = geometric_method(name)
    made, truth = intervals()
    _, found = method.step(method.init(SITE, DEVICES), made)
    torch.testing.assert_close(found.positions[found.fixed], truth[found.fixed], atol=1e-5, rtol=0)
    assert found.fixed.tolist() == [True, False, False, False, True, True, True]


def test_no_fix_comes_with_nan_and_its_reason(name: str) -> None:
    method = geometric_method(name)
    _, found = method.step(method.init(SITE, DEVICES), intervals()[0])
    assert found.reasons[1:4].tolist() == [NoFix.TOO_FEW_RANGES, NoFix.TOO_FEW_RANGES, NoFix.NO_READING]
    assert found.positions.isnan().any(-1).tolist() == (~found.fixed).tolist()
    assert found.covariances.isnan().any(-1).any(-1).tolist() == (~found.fixed).tolist()


def test_covariances_are_symmetric_and_positive(name: str) -> None:
    method = geometric_method(name)
    _, found = method.step(method.init(SITE, DEVICES), intervals()[0])
    covariances = found.covariances[found.fixed]
    torch.testing.assert_close(covariances, covariances.mT)
    assert (torch.linalg.eigvalsh(covariances) > 0).all()


def test_the_order_of_access_points_changes_nothing(name: str) -> None:
    method = geometric_method(name)
    made, _ = intervals()
    made = replace(made, ranges=torch.where(made.heard, made.ranges + 0.7, 0.0))
    order = [4, 2, 0, 5, 1, 3]
    turned = replace(made, ranges=made.ranges[:, order], heard=made.heard[:, order])
    _, one = method.step(method.init(SITE, DEVICES), made)
    _, other = method.step(method.init(site_of(order), DEVICES), turned)
    torch.testing.assert_close(one.positions, other.positions, atol=1e-6, rtol=0, equal_nan=True)


def test_the_order_of_devices_changes_nothing(name: str) -> None:
    method = geometric_method(name)
    made, _ = intervals()
    back = torch.arange(DEVICES - 1, -1, -1)
    turned = replace(made, ranges=made.ranges[back], heard=made.heard[back])
    _, one = method.step(method.init(SITE, DEVICES), made)
    _, other = method.step(method.init(SITE, DEVICES), turned)
    torch.testing.assert_close(one.positions[back], other.positions, atol=1e-9, rtol=0, equal_nan=True)


def test_hostile_ranges_give_finite_fixes_or_none(name: str) -> None:
    method = geometric_method(name)
    generator = torch.Generator().manual_seed(9)
    ranges = torch.rand(2000, len(PLACES), generator=generator, dtype=torch.float64) ** 6 * 600
    heard = torch.rand(2000, len(PLACES), generator=generator) < 0.7
    made = Intervals(
        t_s=torch.zeros(2000, dtype=torch.float64),
        ranges=torch.where(heard, ranges, 0.0),
        stds=torch.zeros_like(ranges),
        rss=torch.zeros_like(ranges),
        heard=heard,
        present=torch.ones(2000, dtype=torch.bool),
    )
    _, found = method.step(method.init(SITE, 2000), made)
    assert torch.isfinite(found.positions[found.fixed]).all()
    assert torch.isfinite(found.covariances[found.fixed]).all()
    assert found.fixed.any() and not found.fixed.all()


def test_a_memoryless_method_returns_its_state_unchanged(name: str) -> None:
    method = geometric_method(name)
    assert isinstance(method, Memoryless) and method.memoryless
    state = method.init(SITE, DEVICES)
    after, _ = method.step(state, intervals()[0])
    assert after is state


def test_an_unknown_method_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=f"'magic', expected one of {', '.join(GEOMETRIC_METHODS)}"):
        geometric_method("magic")
