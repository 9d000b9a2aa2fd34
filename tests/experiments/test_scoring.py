"""Learned methods out of their artifacts, as ``fploc evaluate`` runs them, and what trainings may not see."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

import fploc.experiments.training
from fploc.artifacts import Artifact
from fploc.cli import main
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.records import Record
from fploc.experiments.plan import Learning
from fploc.experiments.preset import Preset
from fploc.experiments.reproduce import Reproduction
from fploc.experiments.scoring import ready_method
from fploc.experiments.stages import StageBook
from fploc.experiments.world import World

KEYS = [
    "method",
    "protocol",
    "site",
    "device",
    "labels",
    "calibration",
    "plan",
    "speed_prior",
    "smoother",
    "thin",
    "filter",
    "preset",
    "seed",
    "n",
    "n_before_first_fix",
    "no_fix_share",
    "rmse_m",
    "rmse_fixed_m",
    "mae_m",
    "p50_m",
    "p90_m",
    "p95_m",
    "coverage95",
    "nees",
    "ms_per_fix",
    "artifact",
    "commit",
    "condition",
]
WORLD = World("office", ("laboratory",), made_up=False)


@dataclass(frozen=True)
class Trained:
    """A packed source and target with trained artifacts; both buildings are made up under public names."""

    root: Path
    runs: Path


def train(preset: Preset, root: Path, runs: Path) -> None:
    """Train everything that the preset trains, and score nothing."""
    stages = Reproduction.on(preset, WORLD, None, root, runs).stages()
    wanted = [one for one in stages if one.name.startswith(("calibrate", "train"))]
    StageBook(runs / "stages").run(wanted)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, miniature: Preset, pack: Any) -> Trained:
    root, runs = tmp_path_factory.mktemp("data"), tmp_path_factory.mktemp("runs")
    pack(root, "office", seed=1)
    pack(root, "laboratory", seed=2, laps=1)
    train(miniature, root, runs)
    return Trained(root, runs)


@pytest.fixture
def evaluate(trained: Trained, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return what calls ``fploc evaluate --json -`` and reads its records."""

    def evaluate(method: str, *more: str) -> list[dict[str, Any]]:
        words = ["--method", method, "--preset", "smoke", "--protocol", "zero-shot", "--site", "laboratory"]
        places = ["--data-root", str(trained.root), "--runs", str(trained.runs), "--json", "-"]
        code = main(["evaluate", *words, *places, *more])
        out, err = capsys.readouterr()
        assert code == 0, err
        return list(json.loads(out))

    return evaluate


def without_time(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in one.items() if name != "ms_per_fix"} for one in records]


def test_json_is_a_list_of_records_with_the_documented_keys_in_order(evaluate: Any) -> None:
    records = evaluate("gnn-fpdnn", "--thin", "5")
    assert [list(one) for one in records] == [KEYS] * 8
    assert [one.name for one in fields(Record)] == KEYS
    kinds = [(one["device"], one["labels"], one["filter"]) for one in records]
    assert kinds == [
        (device, labels, name)
        for device in (1, 2)
        for labels in ("published", "repaired")
        for name in ("none", "kalman")
    ]
    for one in records:
        assert (one["method"], one["protocol"], one["site"]) == ("gnn-fpdnn", "zero-shot", "laboratory")
        assert (one["preset"], one["seed"], one["thin"], one["smoother"]) == ("smoke", 0, 5, False)
        assert one["artifact"] == "smoke/zero-shot/laboratory/gnn-fpdnn/seed-0"
        assert isinstance(one["rmse_m"], float) and one["ms_per_fix"] > 0


def test_two_calls_give_the_same_numbers(evaluate: Any) -> None:
    assert without_time(evaluate("gnn-fpdnn", "--thin", "9")) == without_time(
        evaluate("gnn-fpdnn", "--thin", "9")
    )


def test_device_and_labels_choose_records(evaluate: Any) -> None:
    records = evaluate("gnn", "--device", "2", "--labels", "repaired")
    assert {(one["device"], one["labels"]) for one in records} == {(2, "repaired")} and len(records) == 2
    both = [one for one in evaluate("gnn") if (one["device"], one["labels"]) == (2, "repaired")]
    # Single precision: with other recordings in the batch, sums are rounded otherwise.
    for alone, among in zip(without_time(records), without_time(both), strict=True):
        assert alone.keys() == among.keys()
        for name, value in alone.items():
            expected = pytest.approx(among[name], rel=1e-6) if isinstance(value, float) else among[name]
            assert value == expected, name


def test_thinning_leaves_every_so_manyth_interval(evaluate: Any) -> None:
    whole, thin = (
        sum(one["n"] + one["n_before_first_fix"] for one in evaluate("nls", "--thin", k)[:1])
        for k in ("1", "10")
    )
    assert thin == -(-whole // 10)


def test_speed_prior_acts_on_the_filter_alone(evaluate: Any) -> None:
    slow, fast = evaluate("gnn"), evaluate("gnn", "--speed-prior", "1.4")
    for before, after in zip(slow, fast, strict=True):
        assert (before["speed_prior"], after["speed_prior"]) == (0.5, 1.4)
        assert (before["rmse_m"] == after["rmse_m"]) == (before["filter"] == "none")


@pytest.mark.parametrize("plan", ["blank", "length", "none", "office"])
def test_another_plan_changes_what_looks_at_plans(plan: str, evaluate: Any) -> None:
    real, other = evaluate("gnn-fpdnn", "--thin", "3"), evaluate("gnn-fpdnn", "--thin", "3", "--plan", plan)
    assert {one["plan"] for one in other} == {plan}
    assert all(a["rmse_m"] != b["rmse_m"] for a, b in zip(real, other, strict=True))
    blind = [one["rmse_m"] for one in evaluate("gnn", "--plan", plan)]
    assert blind == [one["rmse_m"] for one in evaluate("gnn")]


def test_calibration_is_the_artifacts_unless_asked_for(evaluate: Any) -> None:
    own, same, other = (
        evaluate("gnn", *words) for words in ((), ("--calibration", "source-los"), ("--calibration", "9"))
    )
    assert without_time(own) == without_time(same)
    assert {one["calibration"] for one in own} == {"source-los"}
    assert {one["calibration"] for one in other} == {"9"}
    assert own[0]["rmse_m"] != other[0]["rmse_m"]


@pytest.mark.parametrize("method", ["nls", "learned-grid", "gnn"])
def test_what_is_made_ready_with_a_calibration_has_it(method: str, trained: Trained) -> None:
    request = EvaluationRequest("zero-shot", "laboratory", preset="smoke")
    assert ready_method(method, request, "2.5", trained.root, trained.runs).offsets.offset_m == 2.5


def test_records_go_to_a_file_and_a_table_to_the_screen(
    trained: Trained, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "records.jsonl"
    places = ["--data-root", str(trained.root), "--runs", str(trained.runs)]
    words = ["--method", "nls", "--site", "laboratory", "--json", str(file)]
    assert main(["evaluate", *words, *places]) == 0
    records = [json.loads(line) for line in file.read_text().splitlines()]
    assert [list(one) for one in records] == [KEYS] * 8
    assert f"{records[0]['rmse_m']:.2f}" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--seed", "7"], "make it: fploc reproduce --preset smoke"),
        (["--preset", "default"], "make it: fploc reproduce --preset default"),
        (["--preset", "tiny"], "--preset: found 'tiny'"),
        (["--plan", "moon"], "moon"),
        (["--protocol", "seen"], "--site with --protocol seen"),
    ],
)
def test_what_cannot_be_evaluated_is_named(
    words: list[str], expected: str, trained: Trained, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["--method", "gnn", "--site", "laboratory", "--preset", "smoke"]
    places = ["--data-root", str(trained.root), "--runs", str(trained.runs)]
    assert main(["evaluate", *asked, *places, *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and expected in err


def test_an_artifact_of_other_data_is_refused(
    trained: Trained, tmp_path: Path, pack: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    pack(tmp_path, "laboratory", seed=2, laps=1, duration_s=12.0)
    (tmp_path / "packed" / "office").symlink_to(trained.root / "packed" / "office")
    words = ["--method", "gnn", "--site", "laboratory", "--preset", "smoke", "--runs", str(trained.runs)]
    assert main(["evaluate", *words, "--data-root", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1 and "data_hash" in err and "fploc reproduce --preset smoke" in err


def weights(runs: Path) -> dict[str, torch.Tensor]:
    """Every weight of every artifact, by file and name."""
    return {
        f"{file.relative_to(runs)}/{name}": value
        for file in sorted(runs.rglob("*.safetensors"))
        for name, value in load_file(file).items()
    }


def differing(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> set[str]:
    """Return the folders protocol/site/method whose weights differ."""
    assert one.keys() == other.keys() and one
    return {
        "/".join(name.split("/")[2:5]) for name, value in one.items() if not torch.equal(value, other[name])
    }


def constants(runs: Path, site: str) -> dict[str, Any]:
    file = runs / "artifacts" / "smoke" / "zero-shot" / site / "gnn-fpdnn" / "seed-0" / "artifact.json"
    return dict(json.loads(file.read_text()))


def test_no_measurement_of_the_target_reaches_a_training(
    trained: Trained, tmp_path: Path, pack: Any, miniature: Preset
) -> None:
    """The same building walked otherwise: other readings, labels and counts, the same plan and APs."""
    pack(tmp_path, "laboratory", seed=2, laps=2, duration_s=17.0)
    (tmp_path / "packed" / "office").symlink_to(trained.root / "packed" / "office")
    readings = "packed/laboratory/readings.parquet"
    assert (tmp_path / readings).read_bytes() != (trained.root / readings).read_bytes()
    for name in ("plan.png", "walls.png"):
        here = tmp_path / "packed" / "laboratory" / name
        assert here.read_bytes() == (trained.root / "packed" / "laboratory" / name).read_bytes()
    train(miniature, tmp_path, tmp_path / "runs")
    assert differing(weights(trained.runs), weights(tmp_path / "runs")) == set()
    before, after = (constants(runs, "laboratory") for runs in (trained.runs, tmp_path / "runs"))
    assert before["constants"] == after["constants"] and before["recordings"] == after["recordings"]
    assert before["data_hash"] != after["data_hash"]
    assert all(name.startswith("office/") for name in before["recordings"])


def test_a_measurement_of_the_source_does_reach_every_training(
    trained: Trained, tmp_path: Path, pack: Any, miniature: Preset
) -> None:
    """The control: the comparison above sees a change where there is one."""
    pack(tmp_path, "office", seed=1, duration_s=25.0)
    (tmp_path / "packed" / "laboratory").symlink_to(trained.root / "packed" / "laboratory")
    train(miniature, tmp_path, tmp_path / "runs")
    assert differing(weights(trained.runs), weights(tmp_path / "runs")) == {
        "seen/office/generator",
        "seen/office/gnn",
        "seen/office/gnn-fpdnn",
        "zero-shot/laboratory/gnn",
        "zero-shot/laboratory/gnn-fpdnn",
    }


def test_networks_that_go_on_learning_learn_as_they_did_at_first(
    trained: Trained, tmp_path: Path, miniature: Preset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Loaded networks are in evaluation mode, in which dropout and batch statistics would stand still."""
    modes: dict[str, bool] = {}

    def spy(task: torch.nn.Module, *_: object, **__: object) -> dict[str, float]:
        modes[type(task).__name__] = all(module.training for module in task.modules())
        return {"val/loss": 1.0}

    monkeypatch.setattr(fploc.experiments.training, "fit", spy)
    reproduction = Reproduction.on(miniature, WORLD, None, trained.root, tmp_path)
    reproduction.learner.artifacts = trained.runs / "artifacts"
    monkeypatch.setattr(Artifact, "save", lambda *_: None)
    reproduction._calibrate()
    reproduction.learner.learn(Learning("zero-shot", "laboratory", 0), lambda network: None)
    assert modes == {"GNNTask": True, "FPDNNTask": True}
