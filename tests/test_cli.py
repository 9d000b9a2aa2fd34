"""The command ``fploc``: what it answers, how fast, and the issue's outside checks through it."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from fploc.cli import main
from fploc.commands.registry import NAMES, make_parser
from fploc.datasets.build import build_sites
from fploc.sites.made_up import made_up_site
from fploc.sites.registry import load_spec

FPLOC = Path(sys.executable).with_name("fploc")
COMMANDS = [
    [],
    *([name] for name in NAMES[""]),
    *([name, own] for name, below in NAMES.items() if name for own in below),
]
SCREEN = 24
HEAVY = ("torch", "lightning", "mlflow", "timm", "torch_geometric", "pandas")


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_explains_itself(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*command, "--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    usage = "usage: fploc [options] fit" if command == ["fit"] else " ".join(["usage: fploc", *command])
    assert out.startswith(usage) and "--help" in out
    # LightningCLI's own options are objects, whose types say what they take.
    assert command == ["fit"] or ("<class" not in out and "lambda" not in out)
    (example,) = re.findall(r"^Example:\n  fploc (.+)$", out, flags=re.MULTILINE)
    words = shlex.split(example.partition(" > ")[0])
    assert words[: len(command)] == command
    if command != ["fit"]:
        assert make_parser().parse_args(words).command == words[0]


def test_help_is_a_table_of_contents_on_one_screen(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= SCREEN and max(len(line) for line in lines) < 80
    listed = [re.match(r"    ([\w-]+) +[A-Z].*\.$", line) for line in lines]
    assert [found[1] for found in listed if found] == list(NAMES[""])


def completed(script: str, *words: str) -> set[str]:
    """Return what bash offers for the last of ``words``."""
    asked = (
        f"{script}\nCOMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _shtab_fploc\n"
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_bash_completes_commands_options_and_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert completed(script, "fploc", "") == set(NAMES[""])
    assert completed(script, "fploc", "data", "b") == {"build"}
    assert completed(script, "fploc", "evaluate", "--me") == {"--method"}
    assert {"nls", "nls-onesided"} <= completed(script, "fploc", "evaluate", "--method", "nl")
    assert completed(script, "fploc", "evaluate", "--site", "sh") == {"shopping-mall"}
    assert completed(script, "fploc", "reproduce", "--preset", "sm") == {"smoke"}


def test_zsh_gets_a_script_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "zsh"]) == 0
    script = capsys.readouterr().out
    assert script.startswith("#compdef fploc") and "shopping-mall" in script


def test_help_answers_within_a_second(tmp_path: Path, unmeasured: dict[str, str]) -> None:
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        done = subprocess.run(
            [FPLOC, "--help"], cwd=tmp_path, env=unmeasured, capture_output=True, text=True, check=False
        )
        seconds.append(time.perf_counter() - began)
        assert done.returncode == 0 and done.stderr == ""
    assert min(seconds) < 1.0
    assert all(name in done.stdout for name in ("data", "made-up", "fit", "evaluate", "reproduce"))


def test_the_command_line_loads_nothing_heavy() -> None:
    code = "import sys, fploc.cli; fploc.cli.make_parser(); print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "fploc.cli" in done.stdout.split()
    assert not set(HEAVY) & set(done.stdout.split())


def test_both_ways_in_are_the_same() -> None:
    ways = ([FPLOC, "--version"], [sys.executable, "-m", "fploc", "--version"])
    printed = [subprocess.run(way, capture_output=True, text=True, check=True).stdout for way in ways]
    assert printed[0] == printed[1] and printed[0].startswith("fploc ")


@pytest.mark.parametrize(
    ("words", "see"),
    [
        ([], "fploc --help"),
        (["fly"], "fploc --help"),
        (["data"], "fploc data --help"),
        (["data", "--fast"], "fploc data --help"),
        (["data", "build", "--sites"], "fploc data build --help"),
        (["evaluate", "--method", "nls"], "fploc evaluate --help"),
        (["evaluate", "--method", "nls", "--site", "office", "--thin", "two"], "fploc evaluate --help"),
        (["evaluate", "--method", "nls", "--site", "office", "--speed-prior", "x"], "fploc evaluate --help"),
        (["made-up", "--seed", "x", "--out", "here"], "fploc made-up --help"),
        (["reproduce", "--presets", "smoke"], "fploc reproduce --help"),
        (["fit", "--trainer.max_epochs=x"], "fploc fit --help"),
        (["fit"], "fploc fit --help"),
        (["tune", "--trials", "x"], "fploc tune --help"),
        (["bench", "--fixes", "many"], "fploc bench --help"),
        (["synthesize"], "fploc synthesize --help"),
        (["completion"], "fploc completion --help"),
        (["completion", "fish"], "fploc completion --help"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_refused_words_end_in_one_line(
    words: list[str],
    see: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1
    assert err.startswith("fploc: ") and err.endswith(f"; see `{see}`\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            [],
            "found no command, expected one of data, made-up, evaluate, reproduce, tune, "
            "model, synthesize, bench, serve, replay, completion, fit;",
        ),
        (["fly"], "found 'fly', expected one of data, made-up, evaluate,"),
        (["data"], "found no command, expected one of download, verify, build, describe, archive;"),
        (["data", "fly"], "found 'fly', expected one of download, verify, build, describe, archive;"),
        (["evaluate"], "required: --method, --site;"),
        (["evaluate", "--method", "nls", "--site", "a", "--thin", "two"], "--thin: Expected a whole number."),
        (
            ["evaluate", "--method", "nls", "--site", "a", "--speed-prior", "x"],
            "--speed-prior: Expected a finite",
        ),
        (["completion"], "required: SHELL;"),
        (["synthesize", "--site", "office", "--json", "x"], "argument --json: invalid choice: 'x'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_refused_words_are_told_in_the_names_of_options(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    err = capsys.readouterr().err
    assert err.startswith("fploc: ") and told in err
    assert "<class" not in err and "data_command" not in err and "evaluate." not in err


@pytest.mark.parametrize("asked", [["--json"], ["--json", "-"]], ids=" ".join)
@pytest.mark.parametrize("command", ["data", "evaluate"])
def test_json_is_asked_for_in_one_way(
    command: str, asked: list[str], data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {
        "data": ["data", "describe", "--sites", "laboratory", "--out", str(tmp_path)],
        "evaluate": ["evaluate", "--method", "lls", "--site", "laboratory", "--thin", "50"],
    }[command]
    assert main([*words, "--data-root", str(data_root), *asked]) == 0
    assert {one["site"] for one in json.loads(capsys.readouterr().out)} == {"laboratory"}


def test_names_of_sites_may_stand_apart(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["data", "describe", "--data-root", str(data_root), "--out", str(tmp_path), "--json"]
    assert main([*words, "--sites", " office, laboratory,,office "]) == 0
    assert [one["site"] for one in json.loads(capsys.readouterr().out)] == ["office", "laboratory"]


def test_a_site_without_recordings_that_was_asked_for_is_told(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    (copy / "2b19c6c" / "raw_data").mkdir(parents=True)
    (copy / "2b19c6c" / "raw_data" / "Laboratory").symlink_to(source / "2b19c6c" / "raw_data" / "Laboratory")
    for file in load_spec("laboratory").files:
        target = copy / file.name
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.symlink_to(source / file.name)
    words = ["data", "build", "--from", str(copy), "--data-root", str(tmp_path / "data"), "--json", "--sites"]
    assert main([*words, "library"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1
    assert f"--sites library: found no recording of it in {copy}" in err
    assert "fploc data download --sites library" in err and "--from" in err
    assert main([*words, "library,shopping-mall"]) == 2
    assert "no recording of library, shopping-mall" in capsys.readouterr().err
    assert main([*words, "library,laboratory"]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("fploc: skipped --sites library: found no recording") and len(err.splitlines()) == 1
    assert [(row["site"], row["state"]) for row in json.loads(out)] == [
        ("library", "absent"),
        ("laboratory", "built"),
    ]


@pytest.mark.parametrize("text", [None, "a: [", "thinn: 2\n"], ids=["missing", "no YAML", "unknown key"])
def test_a_configuration_that_cannot_be_used_is_one_line(
    text: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "evaluate.yaml"
    if text is not None:
        file.write_text(text)
    assert main(["evaluate", "--method", "nls", "--site", "office", "--config", str(file)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_options_may_stand_in_a_file(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "evaluate.yaml"
    options = {"method": "lls", "site": "laboratory", "device": "2", "thin": 30, "data_root": str(data_root)}
    file.write_text(yaml.safe_dump(options))
    assert main(["evaluate", "--config", str(file), "--thin", "40", "--json", "-"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert {(one["method"], one["device"], one["thin"]) for one in records} == {("lls", 2, 40)}


@pytest.mark.parametrize(
    ("site", "device", "calibration", "metres", "tolerance"),
    [
        ("shopping-mall", 1, "none", 2.62, 0.1),
        ("shopping-mall", 2, "none", 6.9, 0.5),
        ("laboratory", 1, "none", 4.59, 0.1),
        ("laboratory", 2, "none", 4.29, 0.1),
        ("shopping-mall", 1, "1.0", 1.52, 0.1),
        ("shopping-mall", 1, "2.4", 1.10, 0.1),
    ],
)
def test_outside_checks(
    site: str,
    device: int,
    calibration: str,
    metres: float,
    tolerance: float,
    data_root: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["--method", "nls", "--protocol", "zero-shot", "--site", site, "--device", str(device)]
    scored = ["--calibration", calibration, "--labels", "published", "--data-root", str(data_root)]
    assert main(["evaluate", *words, *scored, "--json", "-"]) == 0
    (record,) = [one for one in json.loads(capsys.readouterr().out) if one["filter"] == "none"]
    assert (record["device"], record["calibration"], record["labels"]) == (device, calibration, "published")
    assert record["rmse_fixed_m"] == pytest.approx(metres, abs=tolerance)


def test_the_data_root_is_an_option_or_a_variable(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FPLOC_DATA", str(data_root))
    words = ["evaluate", "--method", "lls", "--site", "laboratory", "--thin", "50", "--calibration", "1.0"]
    assert main(words) == 0
    assert "rmse_m" in capsys.readouterr().out
    assert main([*words, "--data-root", str(tmp_path)]) == 2


def test_a_made_up_building_is_written_packed_and_described(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FPLOC_SOURCE", "/nonexistent")
    assert main(["made-up", "--seed", "7", "--out", "building"]) == 0
    said = capsys.readouterr().out
    assert "fploc data build --sites building/made-up-7.yaml" in said
    assert main(["made-up", "--seed", "7", "--out", "again", "--json", "-"]) == 0
    made_up = json.loads(capsys.readouterr().out)
    assert (made_up["site"], made_up["seed"]) == ("again/made-up-7.yaml", 7)
    there = sorted(
        str(path.relative_to(tmp_path)) for path in (tmp_path / "again").rglob("*") if path.is_file()
    )
    assert made_up["files"] == there and made_up["site"] in there
    shutil.rmtree("again")
    assert main(["data", "build", "--sites", "building/made-up-7.yaml", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["site"], row["state"]) == ("made-up-7", "built")
    assert main(["data", "describe", "--sites", "made-up-7", "--out", "pictures"]) == 0
    out, err = capsys.readouterr()
    assert "made-up-7" in out and "written: pictures/index.html\n" in err
    assert {path.name for path in (tmp_path / "pictures").iterdir()} >= {"made-up-7.png", "made-up-7.html"}
    assert main(["data", "archive", "--out", "data.zip", "--json"]) == 0
    archived = json.loads(capsys.readouterr().out)
    assert archived["sites"] == ["made-up-7"] and len(archived["sha256"]) == 64
    made = ["building", "data", "data.zip", "pictures"]
    assert sorted(path.name for path in tmp_path.iterdir()) == made


def test_made_up_buildings_are_archived_only_where_asked_for(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    shutil.copytree(data_root / "packed" / "library", root / "packed" / "library")
    build_sites(None, root, [made_up_site(7, root / "files", laps=1, duration_s=20.0)])
    words = ["data", "archive", "--data-root", str(root), "--out", str(tmp_path / "data.zip"), "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["sites"] == ["library"]
    assert main([*words, "--sites", "made-up-7"]) == 0
    assert json.loads(capsys.readouterr().out)["sites"] == ["made-up-7"]


def test_an_interruption_ends_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fploc.datasets.download.resolve_source", interrupt)
    assert main(["data", "download", "--data-root", str(tmp_path)]) == 130
    assert (
        capsys.readouterr().err == "fploc: interrupted; the next call goes on from the last finished step\n"
    )


def test_verify_of_all_sites_lists_those_that_a_copy_does_not_have(
    source: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FPLOC_SOURCE", str(source))
    assert main(["data", "verify", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["missing"] == [] and printed["checked"] > 100 and "way_out" not in printed
    absent = printed["sites not there"]
    assert "office" not in absent
    for name in absent:
        assert main(["data", "verify", "--sites", name]) == 2


def test_a_reader_that_stops_reading_is_no_error(data_root: Path, tmp_path: Path) -> None:
    words = [FPLOC, "data", "describe", "--json", "--data-root", data_root, "--sites", "office"]
    words += ["--out", tmp_path]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert "Traceback" not in process.stderr.read()
        assert process.wait() == 0
