"""States of many devices side by side, of whatever method: any of them can be advanced alone.

A method's state is a structure of tensors. Those whose first axis grows with the number of devices belong to
devices, one row each; the others (positions of access points) are shared.

Axes: S slots, B devices of a batch.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fploc.localizer import Localizer, LocalizerState

FIRST_SLOTS = 64


def leaves(state: Any) -> list[Tensor]:
    """Return the tensors of a structure of dataclasses and tuples, in order."""
    if isinstance(state, Tensor):
        return [state]
    return [leaf for part in _parts(state) for leaf in leaves(part)]


def with_leaves(state: Any, tensors: Iterator[Tensor]) -> Any:
    """Return a structure of the same form that holds other tensors, in order."""
    if isinstance(state, Tensor):
        return next(tensors)
    if is_dataclass(state) and not isinstance(state, type):
        parts = {one.name: with_leaves(getattr(state, one.name), tensors) for one in fields(state)}
        return replace(state, **parts)
    if isinstance(state, tuple):
        return tuple(with_leaves(part, tensors) for part in state)
    return state


def _parts(state: Any) -> list[Any]:
    if is_dataclass(state) and not isinstance(state, type):
        return [getattr(state, one.name) for one in fields(state)]
    return list(state) if isinstance(state, tuple) else []


class DeviceStates:
    """Slots, each with the state of one device.

    Args:
        localizer: Whose states they are.
    """

    def __init__(self, localizer: Localizer) -> None:
        self._form = localizer.init(1)
        one, two = leaves(self._form), leaves(localizer.init(2))
        self._is_own = [
            len(a.shape) > 0 and (a.shape[0], b.shape[0]) == (1, 2) for a, b in zip(one, two, strict=True)
        ]
        self._fresh = [leaf.clone() for leaf, own in zip(one, self._is_own, strict=True) if own]
        self._shared = [leaf for leaf, own in zip(one, self._is_own, strict=True) if not own]
        self._rows = [self._repeated(leaf, FIRST_SLOTS) for leaf in self._fresh]
        self._free = list(range(FIRST_SLOTS))[::-1]
        parts = [localizer.method.name, *localizer.site.macs]
        parts += [f"{leaf.dtype}{tuple(leaf.shape[1:])}" for leaf in self._fresh]
        self.layout = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    @staticmethod
    def _repeated(leaf: Tensor, times: int) -> Tensor:
        return leaf.repeat(times, *[1] * (leaf.dim() - 1))

    def take_slot(self) -> int:
        """Return a free slot in the state before the first interval; there are always more."""
        if not self._free:
            slots = len(self._rows[0]) if self._rows else FIRST_SLOTS
            self._rows = [
                torch.cat([rows, self._repeated(leaf, slots)])
                for rows, leaf in zip(self._rows, self._fresh, strict=True)
            ]
            self._free = list(range(slots, 2 * slots))[::-1]
        slot = self._free.pop()
        self.reset(torch.tensor([slot]))
        return slot

    def give_back(self, slot: int) -> None:
        """Take a slot back that is no longer needed."""
        self._free.append(slot)

    def reset(self, slots: Tensor) -> None:
        """Put slots (B,) into the state before the first interval."""
        for rows, leaf in zip(self._rows, self._fresh, strict=True):
            rows[slots] = leaf

    def gather(self, slots: Tensor) -> LocalizerState:
        """Return the state of the devices in slots (B,)."""
        own, shared = iter(self._rows), iter(self._shared)
        tensors = (next(own)[slots] if is_own else next(shared) for is_own in self._is_own)
        state: LocalizerState = with_leaves(self._form, tensors)
        return state

    def scatter(self, slots: Tensor, state: LocalizerState) -> None:
        """Put the state of the devices of a batch into their slots (B,)."""
        own = [leaf for leaf, is_own in zip(leaves(state), self._is_own, strict=True) if is_own]
        for rows, leaf in zip(self._rows, own, strict=True):
            rows[slots] = leaf.to(rows.dtype)

    def packed(self, slots: Tensor) -> list[bytes]:
        """Return the state of each device in slots (B,) as bytes."""
        if not self._rows:
            return [b""] * len(slots)
        columns = [
            np.ascontiguousarray(rows[slots].numpy()).reshape(len(slots), -1).view(np.uint8)
            for rows in self._rows
        ]
        return [row.tobytes() for row in np.concatenate(columns, axis=1)]

    def restore(self, slot: int, state: bytes) -> None:
        """Put back what ``packed`` returned; the layout must be the same."""
        start = 0
        for rows in self._rows:
            row = rows[slot]
            size = row.numel() * row.element_size()
            flat = np.frombuffer(state[start : start + size], dtype=row.numpy().dtype)
            rows[slot] = torch.from_numpy(flat.copy()).reshape(row.shape)
            start += size
        assert start == len(state), "the layout promises the size"
