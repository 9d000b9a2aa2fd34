"""The contracts of import-linter hold, and say no more than is so."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import grimp
import pytest
from importlinter.api import read_configuration

ROOT = Path(__file__).parents[2]


def homes() -> list[tuple[str, str]]:
    """Return third-party packages with a home, each with every module that may import it."""
    contracts: list[dict[str, Any]] = read_configuration(str(ROOT / "pyproject.toml"))["contracts_options"]
    return [
        (package, importer)
        for contract in contracts
        if contract["type"] == "protected"
        for package in contract["protected_modules"]
        for importer in contract["allowed_importers"]
    ]


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph("fploc", "datamodules", include_external_packages=True, cache_dir=None)


@pytest.mark.parametrize(("package", "home"), homes())
def test_each_home_is_lived_in(imports: grimp.ImportGraph, package: str, home: str) -> None:
    importers = imports.find_modules_that_directly_import(package)
    assert any(one == home or one.startswith(f"{home}.") for one in importers)


def test_all_contracts_hold() -> None:
    command = [str(Path(sysconfig.get_path("scripts")) / "lint-imports"), "--no-cache"]
    # Its table is drawn with characters beyond ASCII.
    variables = os.environ | {"PYTHONUTF8": "1"}
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
