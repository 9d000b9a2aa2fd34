"""Protocols: what a method may learn from, and what it is tested on (design §6).

Learned parts see the source's recordings only. Of a zero-shot target, its plan, access points and the stream
up to now may be used; no label and no statistic over a whole recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from fploc.datasets.packed import PackedSite
from fploc.datasets.recordings import Recording
from fploc.datasets.splits import RecordingKey
from fploc.errors import FplocError, UnknownNameError

DEVICES = ("1", "2", "all")
PUBLIC_SOURCE = "office"


@dataclass(frozen=True)
class EvaluationProtocol:
    """One protocol.

    Args:
        name: As the command line takes it.
        kind: Tag of its tracked runs.
        source: Site that it learns from.
        meaning: One line for tables and messages.
        tests_on_source: True where the target is the source itself, and only its ``test`` recordings are
            tested on; otherwise the target is any other site, all of whose recordings are.
    """

    name: str
    kind: str
    source: str
    meaning: str
    tests_on_source: bool

    def check_target(self, site: str) -> None:
        """Raise where ``site`` is no target of this protocol.

        Raises:
            FplocError: Saying which sites are.
        """
        if (site == self.source) == self.tests_on_source:
            return
        expected = self.source if self.tests_on_source else f"any site but {self.source}, the source"
        raise FplocError(
            f"--site with --protocol {self.name}",
            value=site,
            expected=expected,
            way_out="choose another site or another protocol",
        )

    def training(self, source: PackedSite) -> list[Recording]:
        """Return the source's recordings to learn from."""
        return _chosen(source, source.splits.train)

    def validation(self, source: PackedSite) -> list[Recording]:
        """Return the source's recordings to validate on."""
        return _chosen(source, source.splits.validate)

    def testing(self, target: PackedSite, device: str) -> list[Recording]:
        """Return the target's recordings to test on.

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
        if self.tests_on_source:
            recordings = _chosen(target, target.splits.test)
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
        tests_on_source=True,
    ),
    EvaluationProtocol(
        name="zero-shot",
        kind="zero-shot",
        source=PUBLIC_SOURCE,
        meaning="office only, to sites never seen: of them plan and access points alone",
        tests_on_source=False,
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


def _chosen(packed: PackedSite, keys: Sequence[RecordingKey]) -> list[Recording]:
    return [one for one in packed.recordings() if (one.device, one.name) in keys]
