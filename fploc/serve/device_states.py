"""States of many devices side by side, of whatever method: any of them can be advanced alone.

A method's state is a structure of tensors. Those whose first axis grows with the number of devices belong to
devices, one row each; the others (positions of access points) are shared. The other axes of a row may be shorter
than they were before the first interval, with 0 for what is left out at their ends: beliefs are held on the cells
that matter, and rows are as long as the longest of them.

Axes: S slots, B devices of a batch.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from fploc.localizer import Localizer, LocalizerState

FIRST_SLOTS = 64
FORMAT = "2"
"""Of stored states."""
SPARE = 0.25
WASTE = 0.5
"""Rows are this much longer than need be, and are made shorter where less than this share of them is needed."""


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


class _Rows:
    """One tensor of the states of all devices.

    Args:
        fresh: Of one device before the first interval, shape (1, …): no row is ever longer.
    """

    def __init__(self, fresh: Tensor) -> None:
        self.fresh = fresh.clone()
        self.values = fresh.repeat(FIRST_SLOTS, *[1] * (fresh.dim() - 1))
        self._lengths = torch.zeros(FIRST_SLOTS, fresh.dim() - 1, dtype=torch.int64)

    def double(self) -> None:
        """Make place for as many devices again."""
        self.values = torch.cat([self.values, torch.zeros_like(self.values)])
        self._lengths = torch.cat([self._lengths, torch.zeros_like(self._lengths)])

    def put(self, slots: Tensor, leaf: Tensor) -> None:
        """Put the rows of a batch, shape (B, …), or one for all, (1, …), into slots (B,)."""
        self._lengths[slots] = torch.tensor(leaf.shape[1:], dtype=torch.int64)
        if leaf.shape[1:] != self.values.shape[1:]:
            self._fit()
            leaf = lengthened(leaf, self.values.shape[1:])
        self.values[slots] = leaf.to(self.values.dtype)

    def drop(self, slot: int) -> None:
        """Forget what is in a slot."""
        self._lengths[slot] = 0

    def own(self, slot: int) -> Tensor:
        """Return the row in a slot as it was put there."""
        row = self.values[slot]
        for axis, length in enumerate(self._lengths[slot].tolist()):
            row = row.narrow(axis, 0, length)
        return row

    # Rows live on: what is made while somebody computes must not be of that inference alone.
    @torch.inference_mode(False)
    def _fit(self) -> None:
        """Make rows as long as the longest of them, and a bit longer, so that this is seldom done."""
        longest = self._lengths.amax(0)
        held = torch.tensor(self.values.shape[1:])
        if bool((longest <= held).all()) and int(longest.prod()) >= WASTE * int(held.prod()):
            return
        most = torch.tensor(self.fresh.shape[1:])
        shape = torch.minimum((longest * (1 + SPARE)).long(), most).tolist()
        kept = self.values
        for axis, length in enumerate(shape, 1):
            kept = kept.narrow(axis, 0, min(length, kept.shape[axis]))
        self.values = lengthened(kept, shape).contiguous()


def lengthened(leaf: Tensor, shape: Sequence[int]) -> Tensor:
    """Return rows (B, …) with zeros at the ends of axes that are shorter than ``shape``."""
    missing = [after - before for before, after in zip(leaf.shape[1:], shape, strict=True)]
    return nn.functional.pad(leaf, [pad for length in missing[::-1] for pad in (0, length)])


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
        self._rows = [_Rows(leaf) for leaf, own in zip(one, self._is_own, strict=True) if own]
        self._shared = [leaf for leaf, own in zip(one, self._is_own, strict=True) if not own]
        self._slots = FIRST_SLOTS
        self._free = list(range(FIRST_SLOTS))[::-1]
        parts = [FORMAT, localizer.method.name, *localizer.site.macs]
        parts += [f"{rows.fresh.dtype}{tuple(rows.fresh.shape[1:])}" for rows in self._rows]
        self.layout = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def take_slot(self) -> int:
        """Return a free slot in the state before the first interval; there are always more."""
        if not self._free:
            for rows in self._rows:
                rows.double()
            self._free = list(range(self._slots, 2 * self._slots))[::-1]
            self._slots *= 2
        slot = self._free.pop()
        self.reset(torch.tensor([slot]))
        return slot

    def give_back(self, slot: int) -> None:
        """Take a slot back that is no longer needed."""
        for rows in self._rows:
            rows.drop(slot)
        self._free.append(slot)

    def reset(self, slots: Tensor) -> None:
        """Put slots (B,) into the state before the first interval."""
        for rows in self._rows:
            rows.put(slots, rows.fresh)

    def gather(self, slots: Tensor) -> LocalizerState:
        """Return the state of the devices in slots (B,)."""
        own, shared = iter(self._rows), iter(self._shared)
        tensors = (next(own).values[slots] if is_own else next(shared) for is_own in self._is_own)
        state: LocalizerState = with_leaves(self._form, tensors)
        return state

    def scatter(self, slots: Tensor, state: LocalizerState) -> None:
        """Put the state of the devices of a batch into their slots (B,)."""
        own = [leaf for leaf, is_own in zip(leaves(state), self._is_own, strict=True) if is_own]
        for rows, leaf in zip(self._rows, own, strict=True):
            rows.put(slots, leaf)

    def packed(self, slot: int) -> bytes:
        """Return the state of the device in a slot as bytes: the lengths of every row's axes, and the row."""
        parts = []
        for rows in self._rows:
            row = rows.own(slot).contiguous().numpy()
            parts += [np.array(row.shape, dtype=np.uint32).tobytes(), row.tobytes()]
        return b"".join(parts)

    def restore(self, slot: int, state: bytes) -> None:
        """Put back what ``packed`` returned; the layout must be the same."""
        start = 0
        for rows in self._rows:
            axes = rows.fresh.dim() - 1
            shape = np.frombuffer(state, dtype=np.uint32, count=axes, offset=start)
            start += shape.nbytes
            dtype = rows.fresh.numpy().dtype
            row = np.frombuffer(state, dtype=dtype, count=int(shape.prod()), offset=start)
            start += row.nbytes
            rows.put(torch.tensor([slot]), torch.from_numpy(row.copy()).reshape(1, *shape.tolist()))
        assert start == len(state), "the layout promises the size"
