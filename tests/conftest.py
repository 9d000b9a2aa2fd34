"""Shared fixtures. Thread settings come first: they hold only when set before torch is imported."""

from __future__ import annotations

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def source() -> Path:
    """Local copy of the public data set, laid out ``<revision>/<path>``."""
    folder = Path(os.environ.get("FPLOC_SOURCE", ROOT.parent / "shared" / "rtt-dataset"))
    if not folder.is_dir():
        _go_without(f"no copy of the public data at {folder}: set FPLOC_SOURCE to one (README, 'Tests')")
    return folder


@pytest.fixture(scope="session")
def reference_plans(source: Path) -> Path:
    """Folder beside the public data with plans that others have georeferenced, to compare with."""
    folder = source.parent / "sites"
    if not (folder / "georeference.json").is_file():
        _go_without(f"no reference plans at {folder}: they lie beside the copy of the public data")
    return folder


def _go_without(message: str) -> NoReturn:
    """Skip a test for want of data; where everything must be there, fail it."""
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def data_root(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data root with every registry site that the local copy holds, built once per test session."""
    from fploc.datasets.build import build_sites
    from fploc.sites.registry import known_sites

    root = tmp_path_factory.mktemp("data-root")
    build_sites(source, root, known_sites())
    return root


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Interruptions raise in every test: Lightning ignores them in a process from the first one on."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
