"""The wheel as it would be published: what it holds, and that it runs far from this checkout."""

from __future__ import annotations

import configparser
import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from fploc.datasets.build import build_sites
from fploc.methods.link_evidence import VIEWS
from fploc.sites.made_up import made_up_site
from fploc.sites.registry import known_sites

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    (found,) = out.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of commands of an environment that holds the wheel; dependencies come from the one in use.

    A ``.pth`` file adds the folder of dependencies without looking at the ``.pth`` files in it, so the
    editable checkout stays out.
    """
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", "--no-cache-dir", str(wheel)], check=True)
    (site_packages,) = folder.glob("lib/python*/site-packages")
    dependencies = sysconfig.get_paths()["purelib"]
    (site_packages / "dependencies.pth").write_text(f"{dependencies}\n")
    return folder / "bin"


def run(installed: Path, words: Sequence[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    variables = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "FPLOC_SOURCE")}
    command = [str(installed / words[0]), *words[1:]]
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, check=False)


def test_it_holds_both_packages_and_everything_they_read(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for package in ("fploc", "datamodules"):
        modules = {str(path.relative_to(ROOT)) for path in (ROOT / package).rglob("*.py")}
        assert modules <= names
    conf = {f"fploc/_conf/{path.relative_to(ROOT / 'conf')}" for path in (ROOT / "conf").rglob("*.yaml")}
    assert conf and conf <= names
    registry = {f"fploc/sites/registry/{name}.yaml" for name in known_sites()}
    assert len(registry) == 9 and registry <= names
    lists = {str(path.relative_to(ROOT)) for path in (ROOT / "fploc/datasets/files").glob("*.tsv")}
    trained = {
        str(path.relative_to(ROOT)) for path in (ROOT / "fploc/pretrained").rglob("*") if path.is_file()
    }
    # A card, and of both artifacts their description and each network.
    assert len(trained) == 1 + 2 * (1 + len(VIEWS)) and trained <= names
    assert lists and lists | {"fploc/evaluation/paper_numbers.tsv"} <= names


def test_it_holds_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"fploc", "datamodules"}
    assert not [
        name for name in names if "__pycache__" in name or name.endswith((".pyc", ".parquet", ".png"))
    ]


def test_it_says_its_command_licence_and_dependencies(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    files = {Path(name).name: name for name in archive.namelist() if ".dist-info/" in name}
    entry_points = configparser.ConfigParser()
    entry_points.read_string(archive.read(files["entry_points.txt"]).decode())
    assert entry_points["console_scripts"]["fploc"] == "fploc.cli:main"
    metadata = archive.read(files["METADATA"]).decode()
    assert "License-Expression: MIT" in metadata and "LICENSE" in files
    assert "Requires-Dist: torch" in metadata and "Requires-Python: >=3.11" in metadata


def test_the_installed_package_is_the_wheels(installed: Path, tmp_path: Path) -> None:
    code = (
        "import fploc, datamodules, torch; from fploc.conf import conf_folder\n"
        "print(fploc.__file__, datamodules.__file__, conf_folder(), torch.__file__, sep='\\n')"
    )
    done = run(installed, ["python", "-c", code], tmp_path)
    *own, dependency = done.stdout.split()
    assert all(Path(path).is_relative_to(installed.parent) for path in own), done.stderr
    assert own[2].endswith("fploc/_conf")
    assert not Path(dependency).is_relative_to(installed.parent)


def test_commands_answer_from_another_folder(installed: Path, tmp_path: Path) -> None:
    for words in (
        ["fploc", "--help"],
        ["fploc", "--version"],
        ["python", "-m", "fploc", "data", "describe", "--help"],
    ):
        done = run(installed, words, tmp_path)
        assert done.returncode == 0 and done.stdout and done.stderr == "", done.stderr
    assert not list(tmp_path.iterdir())


def test_conf_and_registry_are_read_out_of_the_wheel(installed: Path, tmp_path: Path) -> None:
    code = "from fploc.conf import read_conf; print(read_conf('preset', 'smoke')['solver'])"
    assert run(installed, ["python", "-c", code], tmp_path).stdout == "nls-onesided\n"
    site = run(installed, ["fploc", "data", "build", "--sites", "nope"], tmp_path)
    assert site.returncode == 2 and ", ".join(known_sites()) in site.stderr
    assert not list(tmp_path.iterdir())


def test_packed_sites_are_described_from_another_folder(installed: Path, tmp_path: Path) -> None:
    build_sites(None, tmp_path / "data", [made_up_site(4, tmp_path / "files", laps=1, duration_s=15.0)])
    words = ["fploc", "data", "describe", "--data-root", "data", "--out", "cards", "--json"]
    done = run(installed, words, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "made-up-4" in json.dumps(json.loads(done.stdout))
    written = {path.name for path in (tmp_path / "cards").iterdir()}
    assert {"index.html", "made-up-4.html", "made-up-4.png"} <= written
