"""Made-up buildings, packed."""

from __future__ import annotations

from pathlib import Path

import pytest

from fploc.datasets.build import build_sites
from fploc.sites.made_up import made_up_site

MADE_UP = "made-up-5"


@pytest.fixture(scope="session")
def made_up_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data root with one packed made-up building, two laps of half a minute."""
    root = tmp_path_factory.mktemp("made-up-root")
    build_sites(None, root, [made_up_site(5, root / "files", laps=2, duration_s=30.0)])
    return root
