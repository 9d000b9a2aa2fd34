"""Recordings of a packed site, sent to a server as phones would."""

from __future__ import annotations

from pathlib import Path

from fploc.datasets.packed import read_packed
from fploc.errors import FplocError, UnknownNameError
from fploc.serve.phones import Walk
from fploc.serve.recorded import recorded_intervals


def recorded_walks(
    data_root: Path, site: str, device: str, recordings: str | None, phones: int | None
) -> list[Walk]:
    """Return what each phone is to send.

    Args:
        data_root: Folder of packed sites.
        site: Name of a packed site.
        device: ``1``, ``2`` or ``all``: recordings of this device only.
        recordings: Names with commas; None for all.
        phones: How many; None for one for each recording. More than there are recordings repeat them.

    Raises:
        FplocError: If an option cannot be used or nothing is left to send.
    """
    if device not in ("1", "2", "all"):
        raise UnknownNameError("--device", device, known=["1", "2", "all"], way_out="choose one of these")
    if phones is not None and not 1 <= phones <= 1000:
        raise FplocError(
            "--phones", value=phones, expected="a number from 1 to 1000", way_out="give another number"
        )
    packed = read_packed(data_root, site)
    there = [one for one in packed.recordings() if device in ("all", str(one.device))]
    names = None if recordings is None else [name.strip() for name in recordings.split(",")]
    for name in names or ():
        known = [one.name for one in there]
        if name not in known:
            raise UnknownNameError("--recordings", name, known=known, way_out="name these, commas between")
    chosen = [one for one in there if names is None or one.name in names]
    if not chosen:
        raise FplocError(
            f"--site {site}",
            value="no recording",
            expected=f"a recording of device {device}",
            way_out="see `fploc data describe`",
        )
    count = len(chosen) if phones is None else phones
    intervals = [recorded_intervals(one, packed.site) for one in chosen[:count]]
    return [
        Walk(f"phone-{index + 1}", chosen[index % len(chosen)].name, intervals[index % len(chosen)])
        for index in range(count)
    ]
