from __future__ import annotations

import json
from pathlib import Path

import mlflow
import pytest

from fploc.artifacts import ArtifactKey
from fploc.evaluation.run_log import RunLog
from fploc.experiments.registered_models import register_models

PLAIN = ArtifactKey("gnn-fpdnn", "zero-shot", "hall", "full", 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one store: opening a new one takes seconds."""
    return tmp_path_factory.mktemp("runs")


def client(folder: Path) -> mlflow.MlflowClient:
    uri = f"sqlite:///{folder / 'mlflow.db'}"
    return mlflow.MlflowClient(tracking_uri=uri, registry_uri=uri)


def artifact(
    root: Path, key: ArtifactKey, error_m: float, *, weights: bytes = b"weights"
) -> dict[ArtifactKey, Path]:
    """Write what registration reads of an artifact: of both methods, the same error in validation."""
    folder = key.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    constants = {"gnn": {"variance_m2": error_m**2 / 2}, "gnn-fpdnn": {"sigma_m": error_m}, "generator": {}}
    description = {"data_hash": "abc", "command": "fploc reproduce", "constants": constants[key.method]}
    (folder / "artifact.json").write_text(json.dumps(description))
    (folder / "net.safetensors").write_bytes(weights)
    return {key: folder}


def key(**changes: object) -> ArtifactKey:
    return ArtifactKey(**{**PLAIN.__dict__, **changes})  # type: ignore[arg-type]


def test_a_version_says_what_it_was_made_for_and_where_it_lies(folder: Path, tmp_path: Path) -> None:
    register_models(RunLog(folder, "said"), artifact(tmp_path, PLAIN, 0.75), made_up=True)
    (version,) = client(folder).search_model_versions("name = 'gnn-fpdnn, made-up'")
    said = {"protocol": "zero-shot", "target": "hall", "seed": "0", "preset": "full"}
    assert said.items() <= version.tags.items()
    assert version.tags["validation_m"] == "0.750000"
    assert Path(version.source.removeprefix("file://")) == PLAIN.folder(tmp_path)


@pytest.mark.parametrize("method", ["gnn", "gnn-fpdnn"])
def test_the_champion_is_the_zero_shot_version_with_the_least_error_in_validation(
    folder: Path, tmp_path: Path, method: str
) -> None:
    made = {}
    for changes, error_m in (
        ({"seed": 0}, 0.9),
        ({"seed": 1}, 0.7),
        ({"seed": 2, "target": "mall"}, 0.8),
        ({"protocol": "seen", "target": "office"}, 0.1),
        ({"protocol": "fine-tuned"}, 0.2),
        ({"protocol": "zero-shot-pooled"}, 0.3),
        ({"preset": "full--measured"}, 0.4),
    ):
        made |= artifact(tmp_path, key(method=method, **changes), error_m)
    log = RunLog(folder, "champions")
    register_models(log, made, made_up=False)
    champion = client(folder).get_model_version_by_alias(method, "champion")
    assert (champion.tags["seed"], champion.tags["target"], champion.tags["validation_m"]) == (
        "1",
        "hall",
        "0.700000",
    )
    assert len(log.versions(method)) == len(made)
    better = artifact(tmp_path, key(method=method, seed=2, target="mall"), 0.6, weights=b"others")
    register_models(log, better, made_up=False)
    champion = client(folder).get_model_version_by_alias(method, "champion")
    assert (champion.tags["seed"], champion.tags["target"]) == ("2", "mall")
    assert len(log.versions(method)) == len(made), "what is trained again takes the place of its earlier self"


def test_the_same_artifact_is_one_version(folder: Path, tmp_path: Path) -> None:
    log = RunLog(folder, "twice")
    made = artifact(tmp_path, key(method="generator", protocol="seen", target="office"), 0.0)
    register_models(log, made, made_up=True)
    before = log.versions("generator, made-up")
    register_models(log, made, made_up=True)
    assert log.versions("generator, made-up") == before and len(before) == 1


def test_where_nothing_is_zero_shot_there_is_no_champion(folder: Path, tmp_path: Path) -> None:
    made = artifact(tmp_path, key(method="generator", protocol="seen", target="office"), 0.0)
    register_models(RunLog(folder, "none"), made, made_up=False)
    assert client(folder).get_registered_model("generator").aliases == {}
