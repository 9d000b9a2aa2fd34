"""Miniature reproductions: made-up buildings of half a minute a lap, and a preset that trains a few batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import fploc.conf
from fploc.datasets.build import build_sites
from fploc.experiments.preset import Preset, read_preset
from fploc.sites.made_up import made_up_site

LAP_S = 30.0

Pack = Callable[..., None]


@pytest.fixture(scope="module")
def miniature() -> Iterator[Preset]:
    """The preset ``smoke`` of tests/fixtures/conf/, which stands in for conf/ meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        folder = Path(__file__).parents[1] / "fixtures" / "conf"
        patch.setattr(fploc.conf, "conf_folder", lambda: folder)
        yield read_preset("smoke")


@pytest.fixture(scope="session")
def pack() -> Pack:
    """Return what packs a made-up building below a data root under a name of one's choice."""

    def pack(root: Path, name: str, *, seed: int, laps: int = 5, duration_s: float = LAP_S) -> None:
        files = root / f"files-{name}"
        site = made_up_site(seed, files, laps=laps, duration_s=duration_s)
        text = site.read_text(encoding="utf-8")
        site.write_text(text.replace(f"\nname: made-up-{seed}\n", f"\nname: {name}\n"), encoding="utf-8")
        build_sites(None, root, [site])

    return pack
