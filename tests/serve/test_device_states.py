from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from fploc.calibration.offsets import RangeOffsets
from fploc.intervals import Estimate, Intervals
from fploc.localizer import Localizer, LocalizerState
from fploc.serve.device_states import FIRST_SLOTS, DeviceStates
from fploc.sites.site import AccessPoint, Site

LONGEST = (2, 20, 12)


@dataclass(frozen=True)
class Remembered:
    """A method's state: of each device its beliefs and a number, and of all of them the access points."""

    beliefs: Tensor
    number: Tensor
    access_points: Tensor


class Remembering:
    name = "remembering"

    def init(self, site: Site, devices: int) -> Remembered:
        return Remembered(torch.ones(devices, *LONGEST), torch.zeros(devices), torch.zeros(3, 2))

    def step(self, state: Remembered, intervals: Intervals) -> tuple[Remembered, Estimate]:
        raise AssertionError("states are put by hand here")


SITE = Site("box", "box", (AccessPoint("AP0", "00:00:00:00:00:00", 0.0, 0.0, 2.0),), device_height_m=1.0)


def made() -> DeviceStates:
    return DeviceStates(Localizer(Remembering(), SITE, RangeOffsets("none", 0.0)))


def state_of(beliefs: Tensor, number: float = 0.0) -> LocalizerState:
    return LocalizerState(Remembered(beliefs, torch.full((len(beliefs),), number), torch.zeros(3, 2)), None)


def beliefs_of(states: DeviceStates, slots: Tensor) -> Tensor:
    beliefs: Tensor = states.gather(slots).method.beliefs
    return beliefs


def test_a_new_slot_is_in_the_state_before_the_first_interval() -> None:
    states = made()
    slot = states.take_slot()
    states.scatter(torch.tensor([slot]), state_of(torch.full((1, 2, 3, 3), 5.0), 7.0))
    states.give_back(slot)
    assert states.take_slot() == slot
    fresh = states.gather(torch.tensor([slot])).method
    assert fresh.beliefs.shape == (1, *LONGEST) and (fresh.beliefs == 1.0).all()
    assert fresh.number.tolist() == [0.0] and fresh.access_points.shape == (3, 2)


def test_there_are_always_more_slots() -> None:
    states = made()
    slots = [states.take_slot() for _ in range(2 * FIRST_SLOTS + 1)]
    assert len(set(slots)) == len(slots)
    assert (beliefs_of(states, torch.tensor(slots)) == 1.0).all()


@given(
    st.lists(
        st.tuples(st.sets(st.integers(0, 3), min_size=1), st.integers(1, 20), st.integers(1, 12)),
        max_size=12,
    )
)
def test_rows_of_any_length_come_back_as_they_were(puts: list[tuple[set[int], int, int]]) -> None:
    states = made()
    slots = torch.tensor([states.take_slot() for _ in range(4)])
    expected = {device: torch.ones(LONGEST) for device in range(4)}
    for number, (devices, x, y) in enumerate(puts, 1):
        beliefs = torch.full((len(devices), 2, x, y), float(number))
        with torch.inference_mode():
            states.scatter(slots[sorted(devices)], state_of(beliefs, number))
        for device in devices:
            expected[device] = beliefs[0]
    found = beliefs_of(states, slots)
    for device, row in expected.items():
        _, x, y = row.shape
        torch.testing.assert_close(found[device, :, :x, :y], row)
        assert float(found[device].sum()) == float(row.sum())


def test_rows_take_no_more_room_than_the_longest_needs() -> None:
    states = made()
    slots = torch.tensor([states.take_slot() for _ in range(3)])
    states.scatter(slots, state_of(torch.ones(3, 2, 4, 4)))
    assert beliefs_of(states, slots).shape == (3, 2, 5, 5)
    states.scatter(slots[:1], state_of(torch.ones(1, 2, 8, 4)))
    assert beliefs_of(states, slots).shape == (3, 2, 10, 5)
    states.give_back(int(slots[0]))
    states.scatter(slots[1:], state_of(torch.ones(2, 2, 4, 4)))
    assert beliefs_of(states, slots[1:]).shape == (2, 2, 5, 5)


@pytest.mark.parametrize("shape", [(2, 3, 4), (2, 20, 12), (1, 1, 1)])
def test_a_packed_state_is_restored_elsewhere(shape: tuple[int, ...]) -> None:
    states, others = made(), made()
    slot, other = states.take_slot(), others.take_slot()
    beliefs = torch.rand(1, *shape, generator=torch.Generator().manual_seed(3))
    states.scatter(torch.tensor([slot]), state_of(beliefs, 4.0))
    assert states.layout == others.layout
    others.restore(other, states.packed(slot))
    restored = others.gather(torch.tensor([other])).method
    width, x, y = shape
    torch.testing.assert_close(restored.beliefs[:, :width, :x, :y], beliefs, atol=0, rtol=0)
    assert float(restored.beliefs.sum()) == pytest.approx(float(beliefs.sum()))
    assert restored.number.tolist() == [4.0]
    assert len(states.packed(slot)) < 4 * (beliefs.numel() + 8)
