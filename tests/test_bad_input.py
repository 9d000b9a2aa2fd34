"""Every bad input that the issue names, through the command line: one line, exit code 2, nothing half-written."""

from __future__ import annotations

import errno
import os
import re
import resource
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from fploc.cli import main
from fploc.datasets.build import build_sites
from fploc.experiments.scoring import METHODS
from fploc.files import whole
from fploc.sites.made_up import made_up_site

NAME = "made-up-8"
FPLOC = Path(sys.executable).with_name("fploc")

Fails = Callable[..., str]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a made-up building that is in order, and its packed site."""
    folder = tmp_path_factory.mktemp("building")
    site = made_up_site(8, folder, laps=1, duration_s=12.0)
    build_sites(None, folder / "data", [site])
    return folder


@pytest.fixture
def building(original: Path, tmp_path: Path) -> Path:
    """A copy of the building to damage."""
    return Path(shutil.copytree(original, tmp_path / "building"))


@pytest.fixture
def fails(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Fails:
    """Return what calls the command, checks how it ends, and returns its line."""
    monkeypatch.delenv("FPLOC_SOURCE", raising=False)

    def fails(*words: str | Path) -> str:
        assert main([str(word) for word in words]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.startswith("fploc: ")
        assert len(err.splitlines()) == 1, err
        return err

    return fails


def log_of(building: Path) -> Path:
    return sorted((building / NAME / "1").glob("1_3_*.csv"))[0]


def truncate(building: Path) -> Path:
    file = log_of(building)
    file.write_text(file.read_text()[:-60])
    return file


def rename_column(building: Path) -> Path:
    file = log_of(building)
    file.write_text(file.read_text().replace("RTT_TIMESTAMP", "RTT_TIME", 1))
    return file


def change_cell(building: Path, column: str, value: str) -> Path:
    """Put ``value`` into the second data row."""
    file = log_of(building)
    lines = file.read_text().splitlines()
    at = lines[0].split(",").index(column)
    cells = re.findall(r'"[^"]*"|[^,"]+', lines[2])
    cells[at] = value
    lines[2] = ",".join(cells)
    file.write_text("\n".join(lines) + "\n")
    return file


def unknown_mac(building: Path) -> Path:
    file = log_of(building)
    file.write_text(file.read_text().replace("02:00:00:08:00:01", "0a:00:00:00:00:0f"))
    return file


def no_image(building: Path) -> Path:
    file = building / NAME / "floor_plan.png"
    file.write_text("a drawing")
    return file


def empty_log(building: Path) -> Path:
    file = log_of(building)
    file.write_text("")
    return file


DAMAGES: dict[str, tuple[Callable[[Path], Path], str]] = {
    "truncated CSV": (truncate, r"row|line"),
    "wrong column": (rename_column, "RTT_TIMESTAMP"),
    "NaN": (lambda building: change_cell(building, "RTT_TIMESTAMP", "NaN"), "RTT_TIMESTAMP"),
    "text for a number": (lambda building: change_cell(building, "RTT_TIMESTAMP", "soon"), "soon"),
    "text for a range": (lambda building: change_cell(building, "RTT_RESULT", '"[x, y]"'), "RTT_RESULT"),
    "unknown MAC": (unknown_mac, "0a:00:00:00:00:0f"),
    "no image": (no_image, "image"),
    "empty file": (empty_log, r"row|line|column|empty|file"),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_file_is_named_and_nothing_is_written(
    kind: str, building: Path, tmp_path: Path, fails: Fails
) -> None:
    damage, told = DAMAGES[kind]
    file = damage(building)
    line = fails("data", "build", "--sites", building / f"{NAME}.yaml", "--data-root", tmp_path / "data")
    assert file.name in line and re.search(told, line) and "expected" in line
    assert not [path for path in (tmp_path / "data").rglob("*") if path.is_file()]


@pytest.mark.parametrize("kind", ["truncated CSV", "unknown MAC", "no image"])
def test_what_was_packed_before_stays(kind: str, building: Path, fails: Fails) -> None:
    packed = building / "data" / "packed" / NAME
    before = {path.name: path.read_bytes() for path in packed.iterdir()}
    DAMAGES[kind][0](building)
    fails("data", "build", "--sites", building / f"{NAME}.yaml", "--data-root", building / "data")
    assert {path.name: path.read_bytes() for path in packed.iterdir()} == before
    assert [path.name for path in packed.parent.iterdir()] == [NAME]


def change_site(building: Path, change: Callable[[dict], object]) -> Path:  # type: ignore[type-arg]
    file = building / f"{NAME}.yaml"
    document = yaml.safe_load(file.read_text())
    change(document)
    file.write_text(yaml.safe_dump(document))
    return file


SITE_CHANGES: dict[str, tuple[Callable[[dict], object], str]] = {  # type: ignore[type-arg]
    "singular matrix, as collinear points give": (
        lambda site: site["plan"].update(native_from_metres=[[32.0, 0.0, 1.0], [64.0, 0.0, 2.0]]),
        "native_from_metres",
    ),
    "NaN in a matrix": (
        lambda site: site["plan"].update(native_from_metres=[[float("nan"), 0.0, 1.0], [0.0, 1.0, 2.0]]),
        "native_from_metres",
    ),
    "text for a position": (lambda site: site["access_points"][0].update(x_m="left"), "x_m"),
    "a lost key": (lambda site: site["plan"].pop("size_px"), "size_px"),
    "an unknown key": (lambda site: site.update(colour="red"), "colour"),
    "a MAC twice": (
        lambda site: site["access_points"][1].update(mac=site["access_points"][0]["mac"]),
        "02:00:00:08:00:01",
    ),
}


@pytest.mark.parametrize("kind", SITE_CHANGES)
def test_a_site_file_that_cannot_be_used_is_named(
    kind: str, building: Path, tmp_path: Path, fails: Fails
) -> None:
    change, told = SITE_CHANGES[kind]
    file = change_site(building, change)
    line = fails("data", "build", "--sites", file, "--data-root", tmp_path / "data")
    assert file.name in line and told in line
    assert not (tmp_path / "data").exists()


def test_a_missing_recording_or_plan_is_named(building: Path, tmp_path: Path, fails: Fails) -> None:
    (building / NAME / "floor_plan.png").unlink()
    words = ["data", "build", "--sites", building / f"{NAME}.yaml", "--data-root", tmp_path / "data"]
    assert "floor_plan.png" in fails(*words)
    assert not [path for path in (tmp_path / "data").rglob("*") if path.is_file()]
    assert "nowhere.yaml" in fails("data", "build", "--sites", building / "nowhere.yaml")


def test_a_changed_source_file_is_refused(source: Path, tmp_path: Path, fails: Fails) -> None:
    copy = tmp_path / "copy"
    for file in (path for path in source.rglob("*") if path.is_file()):
        target = copy / file.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(file)
    changed = next(path for path in sorted(copy.rglob("*.csv")) if "onference" in str(path))
    contents = changed.read_bytes()
    changed.unlink()
    changed.write_bytes(contents[:-1] + b"9")
    words = ["--from", copy, "--sites", "conference-room", "--data-root", tmp_path / "data"]
    line = fails("data", "build", *words)
    assert changed.name in line and "git blob SHA-1" in line
    assert not [path for path in (tmp_path / "data").rglob("*") if path.is_file()]


def test_a_changed_packed_file_is_refused(building: Path, fails: Fails) -> None:
    file = building / "data" / "packed" / NAME / "readings.parquet"
    file.write_bytes(file.read_bytes() + b"x")
    words = ["--method", "nls", "--site", NAME, "--calibration", "none", "--data-root", building / "data"]
    line = fails("evaluate", *words)
    assert "readings.parquet (SHA-256)" in line and "fploc data build" in line


@pytest.mark.parametrize("state", ["missing", "a file", "empty"])
@pytest.mark.parametrize("command", ["download", "verify", "build"])
def test_an_unusable_source_is_named(
    command: str, state: str, tmp_path: Path, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = tmp_path / "copy"
    if state == "a file":
        named.write_text("x")
    elif state == "empty":
        named.mkdir()
    words = ["data", command, "--sites", "office", "--data-root", tmp_path / "data"]
    assert f"{named} (--from)" in fails(*words, "--from", named)
    monkeypatch.setenv("FPLOC_SOURCE", str(named))
    line = fails(*words)
    assert f"{named} (FPLOC_SOURCE)" in line and "correct FPLOC_SOURCE" in line
    assert not (tmp_path / "data").exists()


def test_an_unreachable_server_is_one_line(
    tmp_path: Path, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setitem(
            fploc_download().__kwdefaults__, "base_url", f"http://127.0.0.1:{free.getsockname()[1]}"
        )
        line = fails("data", "download", "--sites", "office", "--data-root", tmp_path / "data")
    assert "127.0.0.1" in line and "check the network" in line
    assert not [path for path in (tmp_path / "data").rglob("*") if path.is_file()]


def fploc_download() -> Callable[..., Path]:
    from fploc.datasets.download import download

    return download


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--site", "moon"], "packed/moon"),
        (["--method", "nlz"], f"--method: found 'nlz', expected one of {', '.join(METHODS)};"),
        (["--protocol", "guess"], "--protocol: found 'guess'"),
        (["--device", "3"], "--device: found '3'"),
        (["--preset", "huge"], "--preset: found 'huge'"),
        (["--labels", "true"], "--labels: found 'true'"),
        (["--calibration", "lots"], "--calibration: found 'lots'"),
        (["--calibration", "nan"], "--calibration: found 'nan'"),
        (["--thin", "0"], "--thin: found 0"),
        (["--thin", "-3"], "--thin: found -3"),
        (["--speed-prior", "0"], "--speed-prior: found 0"),
        (["--speed-prior", "inf"], "--speed-prior: Expected a finite number"),
        (["--plan", "moon"], "--plan: found 'moon', expected one of real, blank,"),
        (["--site", "office"], "--site with --protocol zero-shot"),
        (["--data-root", "nowhere"], "fploc data build"),
        (["--method", "gnn"], "fploc reproduce --preset default"),
        (["--json", "no/such/folder/records.jsonl"], "no/such/folder/records.jsonl: found no folder no/such"),
        (["--json", "."], "--json .: found a folder, expected a file"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_an_option_that_cannot_be_used_is_named(
    words: list[str],
    told: str,
    packed_world: Path,
    tmp_path: Path,
    fails: Fails,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ["--method", "nls", "--site", NAME, "--calibration", "none", "--data-root", packed_world]
    assert told in fails("evaluate", *asked, *words)
    assert not list(tmp_path.iterdir())


def test_where_records_cannot_go_is_told_before_anything_is_scored(
    packed_world: Path, tmp_path: Path, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fploc.experiments.scoring.answer", lambda *_: pytest.fail("it was evaluated"))
    words = ["--method", "nls", "--site", NAME, "--data-root", packed_world]
    line = fails("evaluate", *words, "--json", tmp_path / "none" / "records.jsonl")
    assert line.endswith("make the folder or name another\n")


@pytest.mark.parametrize(
    "command", ["data download", "data verify", "data build", "data describe", "reproduce"]
)
@pytest.mark.parametrize("sites", ["", " ,, ", "moon", "office,moon"])
def test_sites_that_cannot_be_used_are_named_by_every_command(
    command: str, sites: str, packed_world: Path, fails: Fails
) -> None:
    line = fails(*command.split(), "--sites", sites, "--data-root", packed_world)
    assert line.startswith("fploc: --sites: found ")
    assert "office-position1" in line and "carpark" in line
    assert (NAME in line) == (command == "data describe")


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EFBIG, "free some space"),
        (errno.EACCES, "name a folder that can be written to"),
        (errno.EROFS, "name a folder that can be written to"),
        (errno.EISDIR, "{file} is a folder: name a file"),
        (errno.EIO, "name another place"),
    ],
    ids=lambda value: errno.errorcode[value] if isinstance(value, int) else "",
)
def test_what_the_system_refuses_is_told_with_the_way_out(
    number: int, told: str, tmp_path: Path, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "records.jsonl"

    def refuse(*_: object) -> None:
        with whole(file):
            raise OSError(number, os.strerror(number), f"{file}.part")

    monkeypatch.setattr("fploc.sites.made_up.made_up_site", refuse)
    line = fails("made-up", "--seed", "1", "--out", tmp_path)
    assert line == f"fploc: {file}: {os.strerror(number)}; {told.format(file=file)}, and run again\n"


@pytest.mark.parametrize("kind", ["missing", "a file"])
def test_a_folder_that_is_none_is_told(
    kind: str, tmp_path: Path, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "folder"
    if kind == "a file":
        folder.write_text("x")

    def refuse(*_: object) -> None:
        with whole(folder / "deeper" / "records.jsonl") as part:
            part.write_text("x")

    monkeypatch.setattr("fploc.sites.made_up.made_up_site", refuse)
    line = fails("made-up", "--seed", "1", "--out", tmp_path)
    told = (
        "does not exist: make the folder or name another"
        if kind == "missing"
        else "is no folder: name another"
    )
    assert line.endswith(f"; {folder} {told}, and run again\n") and ".part" not in line


@pytest.fixture(scope="module")
def packed_world(original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The building beside a source named office, so that learned methods look for their artifact."""
    root = tmp_path_factory.mktemp("world")
    site = made_up_site(9, root / "files", laps=1, duration_s=12.0)
    site.write_text(site.read_text().replace("\nname: made-up-9\n", "\nname: office\n"))
    build_sites(None, root, [site, original / f"{NAME}.yaml"])
    return root


@pytest.mark.parametrize("command", ["made-up", "build", "evaluate"])
def test_a_full_disk_ends_in_one_line(
    command: str, original: Path, tmp_path: Path, unmeasured: dict[str, str]
) -> None:
    """The kernel refuses to write beyond a few bytes, as a full disk does."""
    words = {
        "made-up": ["made-up", "--seed", "3", "--out", tmp_path / "out"],
        "build": ["data", "build", "--sites", original / f"{NAME}.yaml", "--data-root", tmp_path / "out"],
        "evaluate": [
            *("evaluate", "--method", "lls", "--site", NAME, "--calibration", "none"),
            *("--data-root", original / "data", "--json", tmp_path / "records.jsonl"),
        ],
    }[command]
    limited = (
        "import resource, sys; from fploc.cli import main\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, (600, {resource.RLIM_INFINITY}))\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command_line = [sys.executable, "-W", "ignore", "-B", "-c", limited, *map(str, words)]
    done = subprocess.run(command_line, env=unmeasured, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("fploc: ")
    finished = [path.name for path in tmp_path.rglob("*") if path.suffix in (".yaml", ".jsonl", ".json")]
    assert finished == []


def test_the_installed_command_ends_the_same_way(tmp_path: Path) -> None:
    words = ["evaluate", "--method", "nls", "--site", "laboratory", "--data-root", "nowhere"]
    done = subprocess.run([FPLOC, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and "fploc data build" in done.stderr
    assert not list(tmp_path.iterdir())
