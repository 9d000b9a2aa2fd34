"""``fploc synthesize`` on small made-up buildings and a generator that has learned nothing."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import fploc.experiments.synthesize
from fploc.artifacts import Artifact, ArtifactKey
from fploc.cli import main
from fploc.conf import instantiate
from fploc.datasets.packed import PackedSite, read_packed
from fploc.evaluation.generator_match import printed_rows
from fploc.experiments.preset import Preset
from fploc.experiments.scoring import data_hash
from fploc.experiments.synthesize import (
    ALL,
    GENERATED,
    HELD_OUT,
    LOOKING,
    MEAN_ONLY,
    MEASURED,
    Readings,
    compared_recordings,
    kind_of,
    match_rows,
)
from fploc.floorplan.plan import read_grey_image
from fploc.models.generator import Generator

MAPS = ["range-error.png", "rss.png"]
MISSES = ["range-error-miss.png", "rss-miss.png"]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, miniature: Preset, pack: Callable[..., None]) -> Path:
    """Two packed buildings under public names, and the generator's artifact of the first."""
    folder = tmp_path_factory.mktemp("synthesize")
    pack(folder, "office", seed=1)
    pack(folder, "laboratory", seed=2, laps=2)
    torch.manual_seed(0)
    source = read_packed(folder, "office")
    spec = miniature.network_specs["generator"]
    Artifact(
        key=ArtifactKey("generator", "seen", "office", "smoke", 0),
        specs={"generator": spec},
        networks={"generator": instantiate(Generator, spec)},
        constants={"heard_shares": [1.0, 0.8]},
        data_hash=data_hash(source),
        recordings=(),
        command="fploc reproduce --preset smoke",
    ).save(folder / "runs" / "artifacts")
    return folder


def words(root: Path, site: str, *more: str) -> list[str]:
    places = ["--data-root", str(root), "--runs", str(root / "runs")]
    return ["synthesize", "--site", site, "--preset", "smoke", *places, *more]


@pytest.fixture(scope="module")
def office(root: Path) -> Path:
    """What a call for the source wrote: its folder, and what it printed as ``printed.json``."""
    out = root / "synthetic-office"
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(io.StringIO()):
        assert main(words(root, "office", "--out", str(out), "--json", "-")) == 0
    (root / "printed.json").write_text(printed.getvalue())
    return out


def test_the_source_is_compared_on_held_out_recordings(root: Path, office: Path) -> None:
    match = json.loads((office / "match.json").read_text())
    assert json.loads((root / "printed.json").read_text()) == match
    packed = read_packed(root, "office")
    assert sorted(path.name for path in office.iterdir()) == sorted([*MAPS, *MISSES, "match.json"])
    assert all(read_grey_image(office / name).std() > 0 for name in [*MAPS, *MISSES])
    assert (match["kind"], match["made_up"], match["labels"]) == (HELD_OUT, True, "repaired")
    assert match["recordings"] == [f"device {device} {name}" for device, name in packed.splits.test]
    assert not set(packed.splits.test) & set(packed.splits.train)
    names = [one.name for one in packed.site.access_points]
    assert [(row["access_point"], row["data"]) for row in match["rows"]] == [
        (name, kind) for name in (*names, ALL) for kind in (MEASURED, GENERATED, MEAN_ONLY)
    ]
    mean_only = [row for row in match["rows"] if row["data"] == MEAN_ONLY]
    assert all(row["local_spread_m"] == row["local_skewness"] == 0.0 for row in mean_only)
    generated = [row for row in match["rows"] if row["data"] == GENERATED]
    assert all(row["local_spread_m"] > 0.0 for row in generated)


def test_measured_rows_are_what_the_packed_tables_say(root: Path, office: Path) -> None:
    match = json.loads((office / "match.json").read_text())
    packed = read_packed(root, "office")
    rows = packed.readings.merge(packed.intervals, on=["device", "recording", "interval"])
    tested = [key in packed.splits.test for key in zip(rows["device"], rows["recording"], strict=True)]
    point = packed.site.access_points[2]
    rows = rows[np.array(tested) & (rows["mac"] == point.mac) & (rows["range_slant_m"] <= 60)]
    rows = rows.dropna(subset=["x_repaired_m"])
    height_m = point.height_m - packed.site.device_height_m
    slant = np.maximum(rows["range_slant_m"].to_numpy() - match["offset_m"], 0.0)
    across = np.sqrt(np.maximum(slant**2 - height_m**2, 0.0))
    truth = np.hypot(rows["x_repaired_m"] - point.x_m, rows["y_repaired_m"] - point.y_m)
    (row,) = [one for one in match["rows"] if (one["access_point"], one["data"]) == (point.name, MEASURED)]
    assert row["n"] == len(rows) > 20
    assert row["bias_m"] == pytest.approx(np.median(across - truth), abs=1e-4)
    assert row["rss_dbm"] == pytest.approx(np.median(rows["rss_dbm"]))
    assert row["rss_bias_db"] == 0.0


def test_other_sites_are_for_looking_only_and_one_seed_repeats(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out_folder = tmp_path / "new" / "folder"
    assert main(words(root, "laboratory", "--out", str(out_folder))) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"laboratory, MADE-UP BUILDING, no real data: {LOOKING}\n")
    assert MEAN_ONLY in out and "skewness" in out
    assert [line.split("/")[-1] for line in err.splitlines()] == [*MAPS, *MISSES, "match.json"]
    match = json.loads((out_folder / "match.json").read_text())
    packed = read_packed(root, "laboratory")
    assert match["recordings"] == [f"device {one.device} {one.name}" for one in packed.recordings()]
    torch.manual_seed(1)
    assert main(words(root, "laboratory", "--json", "-")) == 0
    assert json.loads(capsys.readouterr().out) == match
    assert (root / "runs" / "synthetic" / "laboratory" / "match.json").is_file()


def test_a_site_without_positions_gets_its_maps_and_keeps_no_older_ones(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unlabelled(data_root: Path, site: str) -> PackedSite:
        packed = read_packed(data_root, site)
        labels = {name: np.nan for name in packed.intervals if str(name).endswith("repaired_m")}
        return packed if site == "office" else replace(packed, intervals=packed.intervals.assign(**labels))

    monkeypatch.setattr(fploc.experiments.synthesize, "read_packed", unlabelled)
    (tmp_path / MISSES[0]).write_text("of an older call")
    assert main(words(root, "laboratory", "--out", str(tmp_path))) == 0
    assert "no recording with positions" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*MAPS, "match.json"])
    assert json.loads((tmp_path / "match.json").read_text())["rows"] == []
    assert compared_recordings(unlabelled(root, "laboratory"), "office", "repaired") == []


@pytest.mark.parametrize(
    ("site", "more", "said"),
    [
        ("office", ["--seed", "3"], "make it: fploc reproduce --preset smoke"),
        ("office", ["--source", "laboratory"], "make it: fploc reproduce --preset smoke"),
        ("cellar", [], "fploc data build"),
        ("office", ["--preset", "tiny"], "smoke"),
        ("office", ["--json", "table"], "see `fploc synthesize --help`"),
    ],
)
def test_what_is_not_there_ends_in_one_line(
    site: str, more: list[str], said: str, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words(root, site, "--out", str(tmp_path / "out")), *more]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and said in err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_named(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    assert main(words(root, "office", "--out", str(taken))) == 2
    assert str(taken) in capsys.readouterr().err and taken.read_text() == "a file"


def test_a_site_on_the_sources_floor_is_said_to_be(root: Path) -> None:
    office, laboratory = read_packed(root, "office"), read_packed(root, "laboratory")
    assert kind_of(office, office) == HELD_OUT and kind_of(laboratory, office) == LOOKING
    neighbour = replace(laboratory, site=replace(laboratory.site, place=office.site.place))
    assert kind_of(neighbour, office) == f"{LOOKING}, on the floor of office"


def test_reconstructed_positions_are_said_to_be(root: Path) -> None:
    office, laboratory = read_packed(root, "office"), read_packed(root, "laboratory")
    intervals = laboratory.intervals.assign(x_published_m=np.nan, y_published_m=np.nan)
    assert kind_of(replace(laboratory, intervals=intervals), office) == f"{LOOKING}, positions reconstructed"


def test_access_points_that_nobody_heard_have_no_row() -> None:
    errors = np.column_stack([np.linspace(0.0, 1.0, 9), np.full(9, np.nan), np.linspace(1.0, 3.0, 9)])
    kinds = (MEASURED, GENERATED, MEAN_ONLY)
    readings = Readings(np.zeros((9, 2)), dict.fromkeys(kinds, errors), dict.fromkeys(kinds, -60 - errors))
    rows = match_rows(["AP1", "AP2", "AP3"], readings)
    assert [(row["access_point"], row["n"]) for row in rows[::3]] == [("AP1", 9), ("AP3", 9), (ALL, 18)]
    assert [row["bias_m"] for row in rows[:6:3]] == pytest.approx([0.5, 2.0])
    constant = Readings(np.zeros((9, 2)), dict.fromkeys(kinds, 0 * errors), readings.rss_dbm)
    rows = match_rows(["AP1", "AP2", "AP3"], constant)
    assert rows[0]["dependence"] is None
    assert printed_rows({"rows": rows})[0]["RTT–RSS ρ"] == "–"
