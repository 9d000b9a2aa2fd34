"""Shared fixtures. Thread settings come first: they hold only when set before torch is imported."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def source() -> Path:
    """Local copy of the public data set, laid out ``<revision>/<path>``."""
    folder = Path(os.environ.get("FPLOC_SOURCE", ROOT.parent / "shared" / "rtt-dataset"))
    if not folder.is_dir():
        message = f"no copy of the public data at {folder}: set FPLOC_SOURCE to one (README, 'Tests')"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture(scope="session")
def data_root(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data root with every registry site that the local copy holds, built once per test session."""
    from fploc.datasets.build import build_sites
    from fploc.sites.registry import known_sites

    root = tmp_path_factory.mktemp("data-root")
    build_sites(source, root, known_sites())
    return root
