"""``fploc fit`` on made-up buildings: every experiment, one seed twice, two processes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from lightning.fabric.utilities.distributed import DistributedSamplerWrapper
from safetensors.torch import load_file

from datamodules.measured import MeasuredDataModule
from fploc.artifacts import Artifact, ArtifactKey, load_artifact, offsets_of
from fploc.cli import main
from fploc.conf import conf_folder
from fploc.datasets.packed import read_packed
from fploc.experiments.scoring import data_hash

pytestmark = pytest.mark.filterwarnings("ignore:.*does not have many workers", "ignore:.*GPU available")

EXPERIMENTS = sorted(file.name.removesuffix(".yaml") for file in (conf_folder() / "experiment").iterdir())
SHORT = ["--trainer.max_epochs=2", "--trainer.logger=false", "--trainer.accelerator=cpu"]


@pytest.fixture(scope="module")
def data_root(tmp_path_factory: pytest.TempPathFactory, pack: Any) -> Path:
    """Data root with made-up buildings under the names of two public sites."""
    root = tmp_path_factory.mktemp("data")
    pack(root, "office", seed=1, duration_s=10.0)
    pack(root, "library", seed=2, duration_s=10.0)
    return root


@pytest.fixture(autouse=True)
def _in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def words(experiment: str, data_root: Path, *more: str) -> list[str]:
    data = [f"--data.data_root={data_root}", "--data.batches=4", "--data.batch_size=8"]
    return ["fit", "--config", f"conf/experiment/{experiment}.yaml", *data, *more]


def kept(data_root: Path, method: str, seed: int = 0) -> Artifact:
    """Return what a training left behind below the present folder."""
    key = ArtifactKey(method, "seen", "office", "fit", seed)
    made_from = data_hash(read_packed(data_root, "office"))
    return load_artifact(Path("runs/fit/artifacts"), key, data_hash=made_from, command="again")


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_trains_as_it_stands(experiment: str, data_root: Path) -> None:
    """Its own number of batches, logger and callbacks; Lightning then keeps nothing, and so do we."""
    quick = ["--trainer.fast_dev_run=1", f"--data.data_root={data_root}"]
    assert main(["fit", "--config", f"conf/experiment/{experiment}.yaml", *quick]) == 0
    assert list(Path("runs").rglob("*.safetensors")) == []


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_is_seeded_stops_early_and_keeps_the_best(experiment: str) -> None:
    folder = conf_folder() / "experiment"
    document = yaml.safe_load((folder / f"{experiment}.yaml").read_text(encoding="utf-8"))
    trainer = yaml.safe_load((Path(str(folder)) / document["trainer"]).read_text(encoding="utf-8"))
    assert isinstance(document["seed_everything"], int)
    callbacks = {one["class_path"].rsplit(".", 1)[1]: one["init_args"] for one in trainer["callbacks"]}
    assert callbacks.keys() == {"EarlyStopping", "ModelCheckpoint"}
    assert {one["monitor"] for one in callbacks.values()} == {"val/loss"}
    assert trainer["deterministic"] == "warn" and trainer["gradient_clip_val"] > 0


def test_a_training_leaves_an_artifact_with_its_calibration_and_says_where(
    data_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = words("gnn-office", data_root, "--seed_everything=7", *SHORT)
    assert main(asked) == 0
    (told,) = re.findall(r"^artifact: (.+)$", capsys.readouterr().out, flags=re.MULTILINE)
    assert told == "runs/fit/artifacts/fit/seen/office/gnn/seed-7"
    artifact = kept(data_root, "gnn", seed=7)
    data = MeasuredDataModule(data_root)
    data.setup()
    assert offsets_of(artifact) == data.offsets
    assert artifact.recordings == tuple(f"office/{one.device}/{one.name}" for one in data.recordings("train"))
    assert artifact.constants["labels"] == "repaired" and artifact.constants["validation"]["val/rmse_m"] > 0
    assert artifact.command == "fploc " + " ".join(asked)


@pytest.mark.parametrize("asked_for", [["--json"], ["--json", "-"], ["--json=-"]], ids=" ".join)
def test_json_is_all_that_is_printed(
    data_root: Path, capsys: pytest.CaptureFixture[str], asked_for: list[str]
) -> None:
    assert main(words("gnn-office", data_root, *SHORT, "--trainer.max_epochs=1", *asked_for)) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["artifact"] == "runs/fit/artifacts/fit/seen/office/gnn/seed-0"
    artifact = kept(data_root, "gnn")
    assert done["validation"] == artifact.constants["validation"] and "--json" not in artifact.command


def test_json_of_a_training_that_keeps_nothing(data_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words("gnn-office", data_root, "--trainer.fast_dev_run=1", "--json")) == 0
    assert json.loads(capsys.readouterr().out) == {"artifact": None, "validation": {}}


def test_the_artifact_holds_the_weights_that_were_best_in_validation(data_root: Path) -> None:
    assert main(words("gnn-office", data_root, *SHORT)) == 0
    (best,) = Path("runs/fit").rglob("*.ckpt")
    wanted = torch.load(best, weights_only=True)["state_dict"]
    found = kept(data_root, "gnn").networks["gnn"].state_dict()
    assert found and all(torch.equal(value, wanted[f"network.{name}"]) for name, value in found.items())


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_one_seed_gives_one_network_and_another_another(experiment: str, data_root: Path) -> None:
    def trained(seed: int, folder: str) -> dict[str, torch.Tensor]:
        settings = [*SHORT, f"--trainer.default_root_dir={folder}", f"--seed_everything={seed}"]
        settings += ["--trainer.max_epochs=1", "--data.batches=2"]
        assert main(words(experiment, data_root, *settings)) == 0
        (file,) = Path(folder).rglob("*.safetensors")
        return load_file(file)

    first, again, other = trained(3, "first"), trained(3, "again"), trained(4, "other")
    assert all(torch.equal(value, again[name]) for name, value in first.items())
    assert not all(torch.equal(value, other[name]) for name, value in first.items())


def test_pooled_sites_train_too(data_root: Path) -> None:
    pooled = {
        "class_path": "datamodules.pooled.PooledDataModule",
        "init_args": {"sites": ["office", "library"], "validation_site": "library"},
    }
    Path("pooled.yaml").write_text(yaml.safe_dump({"data": pooled}), encoding="utf-8")
    assert main([*words("gnn-office", data_root, *SHORT), "--config", "pooled.yaml"]) == 0
    (file,) = Path("runs/fit").rglob("artifact.json")
    described = json.loads(file.read_text(encoding="utf-8"))
    assert described["key"]["protocol"] == "zero-shot-pooled" and described["key"]["target"] == "library"
    assert all(name.startswith("office/") for name in described["recordings"])


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"data": {"class_path": "lightning.pytorch.demos.boring_classes.BoringDataModule"}}, "calibrate"),
        ({"model": {"class_path": "lightning.pytorch.demos.boring_classes.BoringModel"}}, "StreamTask"),
    ],
)
def test_other_data_and_tasks_are_refused_before_any_training(
    document: dict[str, Any], expected: str, data_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("other.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    quick = ["--trainer.accelerator=cpu", "--trainer.logger=false"]
    experiment = ["fit", "--config", "conf/experiment/gnn-office.yaml", "--config", "other.yaml", *quick]
    assert main(experiment) == 2
    err = capsys.readouterr().err.splitlines()
    assert expected in err[-1] and not list(Path("runs").rglob("*.ckpt"))


def test_two_processes_train_one_network(data_root: Path) -> None:
    """The YAML is the same; gloo carries the gradients."""
    two = ["--trainer.strategy=ddp", "--trainer.devices=2", "--trainer.max_epochs=1"]
    asked = words("gnn-office", data_root, *two, "--trainer.logger=false", "--trainer.accelerator=cpu")
    environment = os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-m", "fploc", *asked],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "distributed_backend=gloo" in done.stderr and "with 2 processes" in done.stderr
    assert done.stdout.count("artifact: ") == 1
    assert all(torch.isfinite(value).all() for value in kept(data_root, "gnn").networks["gnn"].parameters())
    # Four batches on two processes are two steps each.
    (checkpoint,) = Path("runs/fit").rglob("*.ckpt")
    assert torch.load(checkpoint, weights_only=True)["global_step"] == 2


def test_two_processes_get_batches_of_their_own(data_root: Path) -> None:
    """As Lightning deals out a stream: together they see every batch of it once."""
    data = MeasuredDataModule(data_root, batches=6, batch_size=8)
    data.setup()

    def sampler() -> Any:
        return data.streams(seed=1)["measured"].sampler

    whole = [tuple(batch) for batch in sampler()]
    dealt = [
        [
            tuple(batch)
            for batch in DistributedSamplerWrapper(sampler(), num_replicas=2, rank=rank, shuffle=False)
        ]
        for rank in (0, 1)
    ]
    assert len(set(whole)) == 6 and [len(one) for one in dealt] == [3, 3]
    assert set(dealt[0]) | set(dealt[1]) == set(whole) and not set(dealt[0]) & set(dealt[1])
