"""Protocols: what a method may learn from, and what it is tested on (design §6).

Of a zero-shot target, its plan, access points and the stream up to now may be used; no label and no statistic
over a whole recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from fploc.datasets.packed import PackedSite
from fploc.datasets.path_parts import apart, halves, only, sides
from fploc.datasets.recordings import Recording
from fploc.datasets.splits import RecordingKey
from fploc.errors import FplocError, UnknownNameError
from fploc.sites.site import Site

DEVICES = ("1", "2", "all")
PUBLIC_SOURCE = "office"
MOVED_SITES = ("office-position1", "office-position2")
LINKED_SITES = ("shopping-mall",)
"""Elsewhere the clocks of the two devices and of the link between them have no common zero."""
POOLED_SITES = (
    "office",
    "office-position1",
    "office-position2",
    "conference-room",
    "laboratory",
    "library",
    "shopping-mall",
)
"""Public sites to learn from together; the canteen and the car park are kept for judging from outside."""
MADE_UP_SITES = ("made-up-1", "made-up-2", "made-up-3")
"""Made-up buildings that stand in for them where they cannot be had; others may be packed beside them."""
VALIDATION_SITES = ("library", "laboratory", "made-up-2", "made-up-3")
"""Of pooled sources, the first of these that is there validates."""
SOURCE_FLOOR = ("conference-room", *MOVED_SITES)
"""Sites on the source's floor: its walls were seen in training."""

Bools = NDArray[np.bool_]


class Targets(Enum):
    """Which sites a protocol tests on."""

    SOURCE = "the source"
    OTHERS = "any site but the source"
    ELSEWHERE = "any site of another place than the source's"
    MOVED = "the source's rooms with access points elsewhere"
    LINKED = "sites whose devices and link share a clock"


class Tested(Enum):
    """Which intervals of a target a protocol tests on."""

    TEST_RECORDINGS = "recordings that the site's splits keep for testing"
    EVERYTHING = "all recordings"
    SECOND_PART = "the second part of each recording's path"


@dataclass(frozen=True)
class EvaluationProtocol:
    """One protocol.

    Args:
        name: As the command line takes it.
        kind: Tag of its tracked runs.
        source: Site that it learns from.
        meaning: One line for tables and messages.
        targets: Sites that it tests on.
        tested: What of these.
    """

    name: str
    kind: str
    source: str
    meaning: str
    targets: Targets
    tested: Tested

    def check_target(self, site: str) -> None:
        """Raise where ``site`` is no target of this protocol.

        Raises:
            FplocError: Saying which sites are.
        """
        if self.admits(site):
            return
        expected = {
            Targets.SOURCE: self.source,
            Targets.OTHERS: f"any site but {self.source}, the source",
            Targets.ELSEWHERE: f"a site of another place than that of {self.source}",
            Targets.MOVED: " or ".join(MOVED_SITES),
            Targets.LINKED: " or ".join(LINKED_SITES),
        }
        raise FplocError(
            f"--site with --protocol {self.name}",
            value=site,
            expected=expected[self.targets],
            way_out="choose another site or another protocol",
        )

    def admits(self, site: str) -> bool:
        """Return whether ``site`` is a target of this protocol."""
        admitted = {
            Targets.SOURCE: site == self.source,
            Targets.OTHERS: site != self.source,
            Targets.ELSEWHERE: site not in (self.source, *SOURCE_FLOOR),
            Targets.MOVED: site in MOVED_SITES,
            Targets.LINKED: site in LINKED_SITES,
        }
        return admitted[self.targets]

    def starts_from(self, site: str) -> str | None:
        """Return the protocol whose networks are trained further for ``site``; None where they are new."""
        starts: Mapping[str, str] = {
            "zero-shot": "seen",
            "ap-moved": "seen",
            "zero-shot-pooled": "seen",
            "fine-tuned": "ap-moved" if site in MOVED_SITES else "zero-shot",
        }
        return starts.get(self.name)

    @property
    def trained_under(self) -> str:
        """The protocol whose artifacts are tested: that of two devices at once trains none of its own."""
        return "zero-shot" if self.name == "multi-device" else self.name

    def parts(self, recordings: Sequence[Recording], site: Site) -> list[tuple[Bools, Bools]]:
        """Return which intervals of each recording to fine-tune on and which to test on, shape (T,) each.

        Halves of the path's length; in the source's own rooms the left and the right side, as in the paper.
        Nothing is tested next to where any recording is learned from.
        """
        moved = site.name in MOVED_SITES
        return apart(recordings, [sides(one, site) if moved else halves(one) for one in recordings])

    def sources(self, target: Site, known: Sequence[Site]) -> list[str]:
        """Return the names of the sites that networks for ``target`` learn from, the source first.

        Args:
            target: Site to be tested on.
            known: Packed sites, to pool those of other places from.
        """
        if not self.pools:
            return [self.source]
        others = [
            one.name
            for one in known
            if one.place != target.place
            and one.made_up == target.made_up
            and one.name in (*POOLED_SITES, *MADE_UP_SITES)
        ]
        return list(dict.fromkeys([self.source, *sorted(others)]))

    @property
    def pools(self) -> bool:
        """Whether several sites are learned from."""
        return self.targets is Targets.ELSEWHERE

    def training(self, source: PackedSite) -> list[Recording]:
        """Return the source's recordings to learn from."""
        return _chosen(source, source.splits.train)

    def testing(self, target: PackedSite, device: str) -> list[Recording]:
        """Return the target's recordings, or the parts of them, to test on.

        Args:
            target: Site to be tested on.
            device: ``1``, ``2`` or ``all``.

        Raises:
            UnknownNameError: If there is no such device.
            FplocError: If the site is no target of the protocol, or the device has no recording there.
        """
        if device not in DEVICES:
            raise UnknownNameError("--device", device, known=list(DEVICES), way_out="choose one of these")
        self.check_target(target.site.name)
        recordings = target.recordings()
        if self.tested is Tested.TEST_RECORDINGS:
            recordings = _chosen(target, target.splits.test)
        if self.tested is Tested.SECOND_PART:
            recordings = only(recordings, [second for _, second in self.parts(recordings, target.site)])
        found = [one for one in recordings if device in ("all", str(one.device))]
        if not found:
            there = sorted({str(one.device) for one in recordings})
            raise FplocError(
                f"--device for {target.site.name}",
                value=device,
                expected=f"a device with recordings there: {', '.join(there)}",
                way_out="choose such a device, or `--device all`",
            )
        return found


PROTOCOLS = (
    EvaluationProtocol(
        name="seen",
        kind="seen",
        source=PUBLIC_SOURCE,
        meaning="office laps 1, 2, 4 to lap 5 along the same line: this is memory",
        targets=Targets.SOURCE,
        tested=Tested.TEST_RECORDINGS,
    ),
    EvaluationProtocol(
        name="zero-shot",
        kind="zero-shot",
        source=PUBLIC_SOURCE,
        meaning="office only, to sites never seen: of them plan and access points alone",
        targets=Targets.OTHERS,
        tested=Tested.EVERYTHING,
    ),
    EvaluationProtocol(
        name="zero-shot-pooled",
        kind="zero-shot",
        source=PUBLIC_SOURCE,
        meaning="all sites of other places, to a site never seen",
        targets=Targets.ELSEWHERE,
        tested=Tested.EVERYTHING,
    ),
    EvaluationProtocol(
        name="fine-tuned",
        kind="fine-tuned",
        source=PUBLIC_SOURCE,
        meaning="zero-shot networks tuned on the first part of each path, tested on the second",
        targets=Targets.OTHERS,
        tested=Tested.SECOND_PART,
    ),
    EvaluationProtocol(
        name="ap-moved",
        kind="zero-shot",
        source=PUBLIC_SOURCE,
        meaning="office only, to the same rooms with access points elsewhere",
        targets=Targets.MOVED,
        tested=Tested.EVERYTHING,
    ),
    EvaluationProtocol(
        name="multi-device",
        kind="zero-shot",
        source=PUBLIC_SOURCE,
        meaning="zero-shot networks on two devices at once, with the range between them",
        targets=Targets.LINKED,
        tested=Tested.EVERYTHING,
    ),
)


def protocol_of(name: str, source: str = PUBLIC_SOURCE) -> EvaluationProtocol:
    """Return the protocol of this name.

    Args:
        name: As the command line takes it.
        source: Site that it learns from: another one than the office's only among made-up buildings.

    Raises:
        UnknownNameError: If there is none.
    """
    for one in PROTOCOLS:
        if one.name == name:
            return replace(one, source=source)
    raise UnknownNameError(
        "--protocol", name, known=[one.name for one in PROTOCOLS], way_out="choose one of these"
    )


def can_pool(sources: Sequence[str]) -> bool:
    """Return whether one of several sources can validate and another be learned from."""
    return len(sources) > 1 and any(name in sources for name in VALIDATION_SITES)


def validation_site(sources: Sequence[str]) -> str:
    """Return the one of several sources that validates.

    Raises:
        FplocError: If none of them may, or none would be left to learn from.
    """
    if not can_pool(sources):
        raise FplocError(
            "packed sites to learn from together",
            value=", ".join(sources),
            expected=f"at least two, one of them {' or '.join(VALIDATION_SITES)}",
            way_out="build more sites with `fploc data build`",
        )
    return next(name for name in VALIDATION_SITES if name in sources)


def _chosen(packed: PackedSite, keys: Sequence[RecordingKey]) -> list[Recording]:
    return [one for one in packed.recordings() if (one.device, one.name) in keys]
