"""``fploc reproduce`` from end to end where GitHub cannot be reached: interrupted, resumed, called again."""

from __future__ import annotations

import functools
import io
import json
import re
import socket
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mlflow
import pytest
from mlflow.entities import Run

import fploc.datasets.download
import fploc.experiments.reproduce
import fploc.experiments.world
from fploc.cli import main
from fploc.conf import read_conf
from fploc.datasets.download import Patience, download
from fploc.datasets.packed import read_packed
from fploc.evaluation.records import Record, tracked_record
from fploc.experiments.overviews import experiment_name
from fploc.experiments.plan import Scoring
from fploc.experiments.preset import Preset
from fploc.experiments.reproduce import EXPERIMENT, Reproduction
from fploc.experiments.scoring import data_hash
from fploc.experiments.tracked_scoring import TrackedScoring
from fploc.experiments.world import World
from fploc.sites.made_up import made_up_site
from fploc.sites.registry import known_sites

QUICK = Patience(connect_s=0.5, read_s=0.5, attempts=1)
INTERRUPTED_AT = Scoring("gnn-fpdnn", "seen", "made-up-1", 0, thin=4)


@dataclass(frozen=True)
class Call:
    """One call of the command and what it printed."""

    code: int
    out: str
    err: str

    def stages(self, outcome: str) -> list[str]:
        """Return the stages that ended with ``outcome``, a pattern, in order."""
        return re.findall(rf"^\[\d+/\d+\] (\S+): {outcome}$", self.err, flags=re.MULTILINE)


@dataclass(frozen=True)
class Calls:
    """Three calls on one folder: one interrupted, the next to the end, and one with nothing left to do."""

    root: Path
    interrupted: Call
    left_by_interruption: set[str]
    resumed: Call
    again: Call

    @property
    def folder(self) -> Path:
        return self.root / "runs" / "smoke-made-up"


def call(root: Path, *more: str) -> Call:
    out, err = io.StringIO(), io.StringIO()
    words = [
        "reproduce",
        "--preset",
        "smoke",
        "--data-root",
        str(root / "data"),
        "--runs",
        str(root / "runs"),
        *more,
    ]
    with redirect_stdout(out), redirect_stderr(err):
        code = main(words)
    return Call(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def unreachable() -> Iterator[None]:
    """No source is named, GitHub is a port where nobody listens, and made-up laps are short."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("FPLOC_SOURCE", raising=False)
        nowhere = functools.partial(download, base_url=url, patience=QUICK)
        patch.setattr(fploc.datasets.download, "download", nowhere)
        patch.setattr(fploc.experiments.world, "MADE_UP_SEEDS", (1, 2))
        short = functools.partial(made_up_site, duration_s=30.0)
        patch.setattr(fploc.experiments.world, "made_up_site", short)
        yield


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory, miniature: Preset, unreachable: None) -> Calls:
    root = tmp_path_factory.mktemp("reproduce")
    score = TrackedScoring.score

    def interrupt(self: TrackedScoring, scoring: Scoring) -> None:
        if scoring == INTERRUPTED_AT:
            raise KeyboardInterrupt
        score(self, scoring)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrackedScoring, "score", interrupt)
        interrupted = call(root)
    left = {path.name for path in (root / "runs").rglob("*")}
    return Calls(root, interrupted, left, resumed=call(root), again=call(root))


def tracked(calls: Calls) -> list[Run]:
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}")
    found = client.get_experiment_by_name(EXPERIMENT)
    assert found is not None
    return list(client.search_runs([found.experiment_id]))


def test_no_network_is_said_and_made_up_buildings_take_over(calls: Calls) -> None:
    assert (calls.resumed.code, calls.again.code) == (0, 0)
    assert "Going on with MADE-UP BUILDINGS" in calls.resumed.err
    assert "Traceback" not in calls.interrupted.err + calls.resumed.err + calls.again.err


def test_every_stage_is_announced_once_and_timed(calls: Calls) -> None:
    places = ["seen--made-up-1", "zero-shot--made-up-2"]
    methods = ("nls", "gnn", "gnn-fpdnn")
    scorings = [f"score--{place}--{name}--thin-4--seed-0" for place in places for name in methods]
    chains = ("generator", "seen--made-up-1", "zero-shot--made-up-2")
    trainings = [f"train--{name}--seed-0" for name in chains]
    every = calls.resumed.stages(r"(?:done before|[\d.]+ s)")
    assert every == ["calibrate--made-up-1", *trainings, "synthesize--made-up-1", *scorings, "report"]
    announced = re.compile(r"^preset smoke: trainings take about .*", re.MULTILINE)
    assert len(announced.findall(calls.interrupted.err)) == 1
    assert announced.findall(calls.resumed.err) == [], "nothing was left to train"


def test_an_interruption_ends_in_one_line_and_leaves_nothing_half_written(calls: Calls) -> None:
    assert calls.interrupted.code == 130
    assert calls.interrupted.err.rstrip().splitlines()[-1].startswith("fploc: interrupted; the next call")
    assert not [name for name in calls.left_by_interruption if name.endswith((".part", ".tmp"))]
    assert not [name for name in calls.left_by_interruption if name.startswith(".partial")]
    assert f"{INTERRUPTED_AT.name}.jsonl" not in calls.left_by_interruption


def test_the_next_call_does_only_the_rest(calls: Calls) -> None:
    done = calls.interrupted.stages(r"[\d.]+ s")
    assert done[-1] == "score--seen--made-up-1--gnn--thin-4--seed-0"
    assert calls.resumed.stages("done before") == done
    assert calls.resumed.stages(r"[\d.]+ s")[0] == f"score--{INTERRUPTED_AT.name}"


def test_a_finished_run_does_no_stage_twice(calls: Calls) -> None:
    assert calls.again.stages(r"[\d.]+ s") == []
    assert calls.again.stages("done before") == calls.resumed.stages(r"(?:done before|[\d.]+ s)")
    table = [line for line in calls.resumed.out.splitlines() if "made-up-" in line]
    assert table == [line for line in calls.again.out.splitlines() if "made-up-" in line]


def test_the_table_and_the_places_of_everything_are_printed(calls: Calls) -> None:
    assert "MADE-UP BUILDINGS, no real data" in calls.again.out
    rows = [line.split() for line in calls.again.out.splitlines() if re.match(r"\s+(seen|zero-shot)\s", line)]
    assert len(rows) == 2 * 2 * 3 * 2, "places × devices × methods × filters"
    places = re.findall(r"^\s+(results|records|figures|artifacts): (.+)$", calls.again.out, re.MULTILINE)
    assert [name for name, _ in places] == ["results", "records", "figures", "artifacts"]
    assert all(Path(path).exists() for _, path in places)
    assert f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}" in calls.again.out


def test_json_holds_the_table_and_the_places_and_nothing_else_is_printed(calls: Calls) -> None:
    done = json.loads(call(calls.root, "--json").out)
    assert (done["preset"], done["made_up"], done["labels"]) == ("smoke", True, "repaired")
    lines = [" ".join(line.split()) for line in calls.again.out.splitlines()]
    assert done["rows"] and all(" ".join(row.values()) in lines for row in done["rows"])
    assert done["places"].keys() == {"results", "records", "figures", "artifacts", "MLflow"}
    assert all(Path(place).exists() for name, place in done["places"].items() if name != "MLflow")
    assert done["places"]["MLflow"] == f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}"


def test_everything_made_from_made_up_buildings_says_so(calls: Calls) -> None:
    page = (calls.folder / "results.md").read_text()
    assert "**Made-up buildings.**" in page and "## The paper's own numbers" not in page
    records = [tracked_record(line) for line in (calls.folder / "records.jsonl").read_text().splitlines()]
    assert records and all(one.made_up for one in records)
    assert {run.data.tags["data"] for run in tracked(calls)} == {"made-up"}


def test_figures_are_drawn_for_every_place_and_device(calls: Calls) -> None:
    names = {path.name for path in (calls.folder / "figures").iterdir()}
    places = ("seen--made-up-1", "zero-shot--made-up-2")
    kinds = ("cdf", "cdf-stages")
    drawn = {f"{kind}--{place}--device{n}.png" for kind in kinds for place in places for n in (1, 2)}
    assert drawn < names and {f"attention--{place}.png" for place in places} < names
    assert {name for name in names if name.startswith("bars--")} == {
        f"bars--{protocol}--{behind}.png"
        for protocol in ("seen", "zero-shot")
        for behind in ("kalman", "none")
    }
    assert {Path(name).suffix for name in names} == {".png"}


def test_records_name_their_run_their_data_and_their_artifact(calls: Calls) -> None:
    runs = {run.info.run_id: run for run in tracked(calls)}
    packed = [read_packed(calls.root / "data", name) for name in ("made-up-1", "made-up-2")]
    for line in (calls.folder / "records.jsonl").read_text().splitlines():
        one = tracked_record(line)
        record, run = one.record, runs[one.run_id]
        assert list(json.loads(line))[: len(record.as_json())] == list(record.as_json())
        assert run.data.tags["site"] == record.site and run.data.tags["method"] == record.method
        learned_and_tested = packed[:1] if record.site == "made-up-1" else packed
        assert one.data_hash == data_hash(*learned_and_tested) == run.data.tags["data_hash"]
        artifact = f"smoke/{record.protocol}/{record.site}/{record.method}/seed-0"
        assert record.artifact == (None if record.method == "nls" else artifact)


def test_runs_hold_what_the_records_say(calls: Calls) -> None:
    runs = {run.info.run_id: run for run in tracked(calls)}
    for line in (calls.folder / "records.jsonl").read_text().splitlines():
        one = tracked_record(line)
        metrics = runs[one.run_id].data.metrics
        prefix = f"device{one.record.device}.{one.record.labels}.{one.record.filter}"
        assert metrics[f"{prefix}.rmse_m"] == one.record.rmse_m
        assert metrics[f"{prefix}.ms_per_fix"] == one.record.ms_per_fix


def test_runs_are_tagged_by_kind_and_hold_figures_and_models(calls: Calls) -> None:
    runs = tracked(calls)
    scored = [run for run in runs if run.data.tags["kind"] != "training"]
    kinds = {(run.data.tags["method"], run.data.tags["kind"], run.data.tags["protocol"]) for run in scored}
    assert len(scored) == len(kinds) == 6
    assert {kind for _, kind, _ in kinds} == {"baseline", "seen", "zero-shot"}
    assert all((kind == "baseline") == (method == "nls") for method, kind, _ in kinds)
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}")
    for run in scored:
        figures = {Path(item.path).name for item in client.list_artifacts(run.info.run_id, "figures")}
        assert figures == {f"{kind}-device{device}.png" for kind in ("cdf", "track") for device in (1, 2)}
        model = {Path(item.path).name for item in client.list_artifacts(run.info.run_id, "model")}
        networks = {"nls": [], "gnn": ["gnn"], "gnn-fpdnn": ["gnn", "fpdnn"]}[run.data.tags["method"]]
        expected = {f"{name}.safetensors" for name in networks} | ({"artifact.json"} if networks else set())
        assert model == expected
        assert run.data.params["preset"] == "smoke" and run.info.status == "FINISHED"


def test_an_experiment_of_each_protocol_compares_methods_by_their_runs(calls: Calls) -> None:
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}")
    records = [tracked_record(line) for line in (calls.folder / "records.jsonl").read_text().splitlines()]
    for protocol, site in (("seen", "made-up-1"), ("zero-shot", "made-up-2")):
        found = client.get_experiment_by_name(experiment_name(protocol, "smoke"))
        assert found is not None and "Made-up buildings" in found.tags["mlflow.note.content"]
        runs = {run.info.run_name: run for run in client.search_runs([found.experiment_id])}
        assert set(runs) == {"nls", "gnn", "gnn-fpdnn"}
        for one in (tracked.record for tracked in records):
            if (one.protocol, one.labels, one.filter) == (protocol, "repaired", "kalman"):
                assert runs[one.method].data.metrics[f"{site}/device {one.device} rmse_m"] == one.rmse_m


def test_trainings_log_their_curves(calls: Calls) -> None:
    trainings = [run for run in tracked(calls) if run.data.tags["kind"] == "training"]
    assert len(trainings) == 5, "the generator, then GNN and FPDNN for the source and for the target"
    assert all(any(name.startswith("val/") for name in run.data.metrics) for run in trainings)


def test_every_artifact_is_a_version_of_its_methods_registered_model(calls: Calls) -> None:
    uri = f"sqlite:///{calls.root / 'runs' / 'mlflow.db'}"
    client = mlflow.MlflowClient(tracking_uri=uri, registry_uri=uri)
    registered = {model.name: dict(model.aliases) for model in client.search_registered_models()}
    assert set(registered) == {"generator, made-up", "gnn, made-up", "gnn-fpdnn, made-up"}
    folders = {Path(one.source.removeprefix("file://")) for one in client.search_model_versions()}
    assert folders == {file.parent for file in (calls.root / "runs" / "artifacts").rglob("artifact.json")}
    assert registered["generator, made-up"] == {}
    for name in ("gnn, made-up", "gnn-fpdnn, made-up"):
        champion = client.get_model_version_by_alias(name, "champion")
        assert (champion.tags["protocol"], champion.tags["target"]) == ("zero-shot", "made-up-2")


def test_a_stage_with_a_lost_output_is_done_again_and_what_takes_its_result(calls: Calls) -> None:
    lost = calls.folder / "scores" / "zero-shot--made-up-2--nls--thin-4--seed-0.jsonl"
    before = lost.read_text()
    artifacts = {path: path.stat().st_mtime_ns for path in (calls.root / "runs" / "artifacts").rglob("*")}
    lost.unlink()
    repeated = call(calls.root)
    assert repeated.code == 0
    assert repeated.stages(r"[\d.]+ s") == ["score--zero-shot--made-up-2--nls--thin-4--seed-0", "report"]
    assert artifacts == {path: path.stat().st_mtime_ns for path in artifacts}
    same = [
        replace(tracked_record(line).record, ms_per_fix=0.0)
        for text in (before, lost.read_text())
        for line in text.splitlines()
    ]
    assert same[: len(same) // 2] == same[len(same) // 2 :]
    assert all(isinstance(one, Record) for one in same)


def test_the_report_is_made_anew_where_another_method_stands(calls: Calls, miniature: Preset) -> None:
    world = World("made-up-1", ("made-up-2",), made_up=True)

    def report_key(methods: tuple[str, ...]) -> str:
        preset = replace(miniature, methods=methods)
        made = Reproduction.on(preset, world, None, calls.root / "data", calls.root / "runs")
        return made.stages()[-1].key

    assert report_key(("nls", "gnn")) != report_key(("lls", "gnn"))


def test_a_score_is_made_anew_where_what_it_is_scored_with_has_changed(
    calls: Calls, miniature: Preset, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World("made-up-1", ("made-up-2",), made_up=True)
    studied = replace(
        miniature,
        methods=("nls", "bayes-grid"),
        plans=("real", "made-up-2"),
        calibrations=("none",),
        access_point_counts=(4,),
    )

    def keys(preset: Preset) -> dict[str, str]:
        made = Reproduction.on(preset, world, None, calls.root / "data", calls.root / "runs")
        return {one.name: one.key for one in made.stages() if one.name.startswith("score--")}

    before = keys(studied)

    def changed(preset: Preset) -> set[str]:
        return {name for name, key in keys(preset).items() if before[name] != key}

    assert changed(studied) == set()
    assert changed(replace(studied, calibrations=("none", "source-mac"))) == {
        name for name in before if "study-calibrations" in name
    }
    assert changed(replace(studied, access_point_counts=(3,))) == {
        name for name in before if "study-equipment" in name
    }
    given = read_conf

    def altered(group: str, name: str) -> Any:
        values = given(group, name)
        if name == "bayes-grid":
            values["init_args"]["cell_m"] = 2.0
        return values

    monkeypatch.setattr(fploc.experiments.reproduce, "read_conf", altered)
    assert changed(studied) == {name for name in before if "bayes-grid" in name} != set()


@pytest.mark.parametrize("state", ["missing", "a file", "empty"])
def test_an_unusable_source_ends_before_anything_is_made(
    state: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, miniature: Preset
) -> None:
    named = tmp_path / "copy"
    if state == "a file":
        named.write_text("x")
    elif state == "empty":
        named.mkdir()
    monkeypatch.setenv("FPLOC_SOURCE", str(named))
    began = time.perf_counter()
    ended = call(tmp_path)
    assert ended.code == 2 and ended.out == ""
    assert re.fullmatch(r"fploc: .*copy \(FPLOC_SOURCE\): .*correct FPLOC_SOURCE.*\n", ended.err)
    assert time.perf_counter() - began < 30
    assert not (tmp_path / "data").exists() and not (tmp_path / "runs").exists()


def test_an_unknown_site_is_named(tmp_path: Path, source: Path, miniature: Preset) -> None:
    err = io.StringIO()
    words = ["reproduce", "--preset", "smoke", "--sites", "moon", "--from", str(source)]
    with redirect_stderr(err):
        code = main([*words, "--data-root", str(tmp_path), "--runs", str(tmp_path / "runs")])
    assert code == 2 and len(err.getvalue().splitlines()) == 1
    assert "'moon'" in err.getvalue() and known_sites()[0] in err.getvalue()
    assert not list(tmp_path.iterdir())
