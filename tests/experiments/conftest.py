"""Miniature reproductions: made-up buildings of half a minute a lap, and a preset that trains a few batches."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import pytest

import fploc.conf
from fploc.datasets.build import build_sites
from fploc.experiments.preset import Preset, read_preset
from fploc.sites.made_up import made_up_site

LAP_S = 30.0

Pack = Callable[..., None]


@pytest.fixture(scope="module")
def small_conf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """conf/ with the files of tests/fixtures/conf/ over its own, which stands in for conf/ meanwhile."""
    folder = tmp_path_factory.mktemp("small") / "conf"
    with resources.as_file(fploc.conf.conf_folder()) as conf:
        shutil.copytree(conf, folder)
    shutil.copytree(Path(__file__).parents[1] / "fixtures" / "conf", folder, dirs_exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fploc.conf, "conf_folder", lambda: folder)
        yield folder


@pytest.fixture(scope="module")
def miniature(small_conf: Path) -> Preset:
    """The preset ``smoke`` of tests/fixtures/conf/."""
    return read_preset("smoke")


@pytest.fixture(scope="module")
def every_kind(small_conf: Path) -> Preset:
    """The preset ``full`` of tests/fixtures/conf/: every kind of training and scoring once."""
    return read_preset("full")


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
