"""What a reproduction runs on: the public sites, or made-up buildings where these cannot be had."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fploc.datasets.build import build_sites
from fploc.datasets.download import UnreachableError, resolve_source
from fploc.datasets.packed import packed_folder, packed_sites, read_manifest
from fploc.datasets.source_files import split_by_presence
from fploc.errors import FplocError, MissingFileError
from fploc.evaluation.protocols import PUBLIC_SOURCE
from fploc.progress import track
from fploc.sites.made_up import made_up_site

MADE_UP_SEEDS = (1, 2, 3)
MADE_UP_LAPS = 5
NOTICE_WIDTH = 88


@dataclass(frozen=True)
class World:
    """Sites to learn from and to test on.

    Args:
        source: Packed site that zero-shot methods learn on.
        others: The other packed sites.
        made_up: True where the buildings are made up.
    """

    source: str
    others: tuple[str, ...]
    made_up: bool


def prepare_world(data_root: Path, given: Path | None, others: Sequence[str]) -> World:
    """Get the data of the source and of ``others`` and pack them; made-up buildings where there is no way.

    Raises:
        FplocError: If a named source is unusable, or a file is not what it should be.
    """
    sites = list(dict.fromkeys([PUBLIC_SOURCE, *others]))
    try:
        source = resolve_source(data_root, given, sites)
    except UnreachableError as error:
        _say(_no_data_notice(str(error)))
        return _made_up_world(data_root)
    present, absent = split_by_presence(source, sites)
    if PUBLIC_SOURCE not in present:
        raise FplocError(
            str(source),
            value=f"no recording of {PUBLIC_SOURCE}",
            expected=f"the recordings of {PUBLIC_SOURCE}, which everything is learned on",
            way_out="complete the copy, or unset FPLOC_SOURCE",
        )
    if absent:
        _say(f"skipped, since {source} has no recording of them: {', '.join(absent)}")
    for site in track(present, "build"):
        build_sites(source, data_root, [site])
    return World(PUBLIC_SOURCE, tuple(site for site in present if site != PUBLIC_SOURCE), made_up=False)


def packed_world(data_root: Path) -> World:
    """Return what is packed already: the public sites, or made-up buildings where the public source is not there.

    Raises:
        MissingFileError: If nothing is packed.
    """
    names = packed_sites(data_root)
    made_up = {name: read_manifest(packed_folder(data_root, name))["made_up"] for name in names}
    is_public = PUBLIC_SOURCE in names
    sites = [name for name in names if made_up[name] != is_public]
    if not sites:
        raise MissingFileError(
            packed_folder(data_root, PUBLIC_SOURCE),
            expected=f"{PUBLIC_SOURCE}, which everything is learned on",
            way_out="build it with `fploc data build`",
        )
    source = PUBLIC_SOURCE if is_public else sites[0]
    return World(source, tuple(name for name in sites if name != source), made_up=not is_public)


def _no_data_notice(reason: str) -> str:
    """Return the block that says why there are no data and what happens instead."""
    paragraphs = (
        reason,
        "Going on with MADE-UP BUILDINGS: every table, figure and run made from them says so.",
        "For the real data: connect to the network, or set FPLOC_SOURCE to a local copy.",
    )
    wrapped = [line for paragraph in paragraphs for line in textwrap.wrap(paragraph, NOTICE_WIDTH)]
    body = "\n".join(f"  │ {line}" for line in wrapped)
    return f"\n  ┌─ No data {'─' * (NOTICE_WIDTH - 8)}\n{body}\n  └{'─' * (NOTICE_WIDTH + 2)}\n"


def _made_up_world(data_root: Path) -> World:
    folder = data_root / "made-up"
    names = []
    for seed in track(MADE_UP_SEEDS, "made-up buildings"):
        file = folder / f"made-up-{seed}.yaml"
        if not file.is_file():
            made_up_site(seed, folder, laps=MADE_UP_LAPS)
        names.append(build_sites(None, data_root, [file])[0].site)
    return World(names[0], tuple(names[1:]), made_up=True)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201
