"""What the pages promise holds: code runs, commands parse, targets exist, nothing names one machine."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from fploc.commands.registry import make_parser
from fploc.evaluation.protocols import PROTOCOLS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
README = PAGES[0]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    return [body for found, body in FENCE.findall(page.read_text("utf-8")) if found == language]


def commands(page: Path) -> list[str]:
    """Return every quoted `fploc …` command line, without comments and without `fit`."""
    inline = re.findall(r"`((?:\.venv/bin/)?fploc [^`]+)`", FENCE.sub("", page.read_text("utf-8")))
    lines = [line for block in blocks(page, "") for line in block.splitlines() if line.startswith("fploc ")]
    words = [shlex.split(line.partition(" > ")[0], comments=True) for line in inline + lines]
    return [
        shlex.join(line[1:]) for line in words if line[1] not in ("fit", "--help") and "--help" not in line
    ]


COMMANDS = sorted({command for page in PAGES for command in commands(page)})


def test_python_example_runs_and_gives_positions(tmp_path: Path) -> None:
    tracks, one_set = blocks(README, "python")
    checked = (
        f"{tracks}{one_set}import numpy\nnumpy.save('positions.npy', tracks[0].filtered.positions_m)\n"
        "truth = packed.recordings()[0].repaired_m[0]\n"
        "numpy.save('error.npy', fix.positions[0].numpy() - truth)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", checked], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    positions = np.load(tmp_path / "positions.npy")
    assert positions.ndim == 2 and positions.shape[1] == 2 and len(positions) > 100
    assert np.isfinite(positions).mean() > 0.9
    assert np.linalg.norm(np.load(tmp_path / "error.npy")) < 4.0
    calls = [line for line in one_set.splitlines() if line and not line.startswith("from ")]
    assert len(calls) == 5


def test_commands_are_found() -> None:
    assert {command.split()[0] for command in COMMANDS} >= {"data", "made-up", "evaluate", "reproduce"}


@pytest.mark.parametrize("command", COMMANDS)
def test_quoted_command_line_parses(command: str) -> None:
    assert make_parser().parse_args(shlex.split(command)).command == command.split()[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_quoted_make_targets_exist(page: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), flags=re.MULTILINE)
    text = page.read_text("utf-8")
    named = re.findall(r"`make ([a-z-]+)", text) + re.findall(r"^make ([a-z-]+)", text, flags=re.MULTILINE)
    assert page != README or {"reproduce", "test", "ui", "help", "notebooks", "lint"} <= set(named)
    assert set(named) <= set(targets)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_within_the_repository_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        assert (page.parent / link).exists(), link


def test_paths_named_in_code_spans_exist() -> None:
    for page in PAGES[:2]:
        for path in re.findall(
            r"`((?:fploc|tests|conf|docs|notebooks|\.ci)/[\w./-]+)`", page.read_text("utf-8")
        ):
            assert (ROOT / path).exists(), f"{page.name}: {path}"


def test_every_preset_has_its_row() -> None:
    section = README.read_text("utf-8").partition("### Presets\n")[2].partition("\n### ")[0]
    rows = re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)
    assert set(rows) == {path.stem for path in (ROOT / "conf" / "preset").glob("*.yaml")}


def test_every_protocol_has_its_row() -> None:
    section = README.read_text("utf-8").partition("| protocol |")[2].partition("\n\n")[0]
    assert re.findall(r"^\| `([\w-]+)` \|", section, flags=re.MULTILINE) == [one.name for one in PROTOCOLS]


def test_citation_agrees_with_the_project() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    assert f'version = "{citation["version"]}"' in project
    assert citation["references"][0]["title"] in " ".join(README.read_text("utf-8").replace(">", "").split())


def test_hooks_run_from_the_environment_alone() -> None:
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))
    assert [repository["repo"] for repository in config["repos"]] == ["local"]
    hooks = [hook for repository in config["repos"] for hook in repository["hooks"]]
    assert all(hook["language"] == "system" and hook["entry"].startswith(".venv/bin/") for hook in hooks)


def test_nothing_tracked_names_one_machine_or_a_package_registry() -> None:
    # Put together here, so that this file does not name them either.
    hosts = ["pypi" + ".org", "python" + "hosted", "download." + "pytorch", "ana" + "conda", "conda" + ".io"]
    folders = [rf"(?<![\w.<>-])/{name}/" for name in ("work", "tmp", "root", "home")]
    unwanted = re.compile("|".join([*map(re.escape, hosts), *folders]))
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    assert listed.returncode == 0, "git lists the files of a checkout, which tests run in"
    found = []
    for name in filter(None, listed.stdout.split("\0")):
        try:
            text = (ROOT / name).read_text("utf-8")
        except (UnicodeDecodeError, FileNotFoundError):
            continue
        found += [f"{name}: {match}" for match in unwanted.findall(text)]
    assert not found
