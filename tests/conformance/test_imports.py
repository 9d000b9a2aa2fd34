"""The contracts of import-linter: they name the whole tree, and hold."""

from __future__ import annotations

import ast
import os
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import pytest
from importlinter.api import read_configuration

ROOT = Path(__file__).parents[2]
PACKAGES = ("fploc", "datamodules")
HOMES = {
    "cv2": {"fploc.floorplan"},
    "filterpy": {"fploc.filters"},
    "mlflow": {"fploc.evaluation.run_log"},
    "openpyxl": {"fploc.raw"},
    # Beyond the plots, `Figure` is a type in modules that hand figures on or write them.
    "matplotlib": {
        "fploc.plots",
        "fploc.datasets.data_card",
        "fploc.datasets.describe",
        "fploc.evaluation.run_log",
        "fploc.experiments.figures",
        "fploc.experiments.reproduce",
        "fploc.experiments.synthesize",
    },
    "httpx": {"fploc.datasets.download", "fploc.serve"},
    "mlcroissant": {"fploc.datasets.croissant"},
    "sklearn": {"fploc.methods"},
    "optuna": {"fploc.experiments"},
    "threadpoolctl": {"fploc.experiments"},
    "fastapi": {"fploc.serve"},
    "starlette": {"fploc.serve"},
    "uvicorn": {"fploc.serve"},
    "pydantic": {"fploc.serve"},
    # The run log names the error of MLflow's database.
    "sqlalchemy": {"fploc.evaluation.run_log", "fploc.serve"},
    "prometheus_client": {"fploc.serve"},
}


def one_home_contracts() -> dict[str, dict[str, Any]]:
    contracts = read_configuration(str(ROOT / "pyproject.toml"))["contracts_options"]
    return {
        contract["forbidden_modules"][0]: contract
        for contract in contracts
        if contract["type"] == "forbidden"
    }


def tree() -> dict[str, Path]:
    """Return the files of all modules by their dotted names; a package is its ``__init__.py``."""
    files = [file.relative_to(ROOT) for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    return {".".join(file.with_suffix("").parts).removesuffix(".__init__"): ROOT / file for file in files}


def lies_in(module: str, packages: set[str]) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def test_every_home_has_a_contract() -> None:
    assert one_home_contracts().keys() == HOMES.keys()


@pytest.mark.parametrize("package", HOMES)
def test_a_contract_names_everything_but_the_home(package: str) -> None:
    contract = one_home_contracts()[package]
    homes, modules = HOMES[package], tree()
    listed = set(contract["source_modules"])
    assert listed <= modules.keys(), "named, but not in the tree"
    around = {module for module in modules if any(home.startswith(f"{module}.") for home in homes)}
    assert not listed & around and not [module for module in listed if lies_in(module, homes)]
    missing = {module for module in modules if not lies_in(module, listed | homes)} - around
    assert not missing, "add them to the contract in pyproject.toml"
    # The packages around a home cannot be named without it, so they import nothing at all.
    for module in around:
        nodes = ast.walk(ast.parse(modules[module].read_text(encoding="utf-8")))
        assert not [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)], module


def test_all_contracts_hold() -> None:
    command = [str(Path(sysconfig.get_path("scripts")) / "lint-imports"), "--no-cache"]
    # Its table is drawn with characters beyond ASCII.
    variables = os.environ | {"PYTHONUTF8": "1"}
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
