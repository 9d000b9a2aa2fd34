from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import fploc.artifacts
from fploc.artifacts import FORMAT_VERSION, Artifact, ArtifactKey, load_artifact
from fploc.conf import instantiate
from fploc.errors import BadFileError, FplocError, MissingArtifactError
from fploc.models.fpdnn import Sight

KEY = ArtifactKey(method="gnn-fpdnn", protocol="zero-shot", target="hall", preset="smoke", seed=3)
COMMAND = "fploc reproduce --preset smoke"
SPECS: dict[str, dict[str, Any]] = {
    "gnn": {
        "class_path": "fploc.models.gnn.GNN",
        "init_args": {"hidden": 8, "message_width": 2, "layers": 1},
    },
    "fpdnn": {
        "class_path": "fploc.models.fpdnn.FPDNN",
        "init_args": {
            "vision": {
                "class_path": "fploc.models.deepvit.DeepViT",
                "init_args": {
                    "crop_height_px": 20,
                    "max_length_px": 40,
                    "patch_px": [20, 10],
                    "dim": 8,
                    "depth": 1,
                    "num_heads": 2,
                    "head_dim": 4,
                },
            },
            "head": {"class_path": "fploc.models.fpdnn.DistanceHead", "init_args": {"features": 64}},
        },
    },
}
CONSTANTS = {"offsets": {"offset_m": 1.5, "by_mac": {}}, "variance_m2": 0.1 + 0.2, "solver": "nls"}


def artifact(seed: int = 0, parts: tuple[str, ...] = ("gnn", "fpdnn")) -> Artifact:
    """Networks as after a training: random weights, statistics of norms that are not their defaults."""
    torch.manual_seed(seed)
    networks: Mapping[str, torch.nn.Module] = {
        name: instantiate(torch.nn.Module, SPECS[name]) for name in parts
    }
    for network in networks.values():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.uniform_(0.1, 0.5)
    return Artifact(
        key=KEY,
        specs={name: SPECS[name] for name in parts},
        networks=networks,
        constants=CONSTANTS,
        data_hash="abc",
        recordings=("office/1/113", "office/1/213"),
        command=COMMAND,
    )


def load(root: Path, key: ArtifactKey = KEY, data_hash: str = "abc") -> Artifact:
    return load_artifact(root, key, data_hash=data_hash, command=COMMAND)


@torch.no_grad()
def distances(made: Artifact) -> Tensor:
    inputs = (
        torch.rand(4, 1, 20, 40, generator=torch.Generator().manual_seed(1)),
        torch.tensor([3, 12, 25, 40]),
    )
    sight = torch.full((4,), int(Sight.PLAN))
    return made.networks["fpdnn"](*inputs, torch.arange(4.0), torch.full((4,), -60.0), sight)


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


FOLDER = "smoke/zero-shot/hall/gnn-fpdnn/seed-3"
WRITTEN = {f"{FOLDER}/{name}" for name in ("artifact.json", "gnn.safetensors", "fpdnn.safetensors")}


def test_a_saved_artifact_gives_the_same_outputs(tmp_path: Path) -> None:
    made = artifact()
    folder = made.save(tmp_path)
    assert folder == tmp_path / FOLDER and files(tmp_path) == WRITTEN
    loaded = load(tmp_path)
    for network in made.networks.values():
        network.eval()
    assert torch.equal(distances(loaded), distances(made))
    for name, network in made.networks.items():
        expected = network.state_dict()
        found = loaded.networks[name].state_dict()
        assert set(found) == set(expected)
        assert all(torch.equal(found[key], expected[key]) for key in expected)


def test_loaded_networks_are_in_evaluation_mode(tmp_path: Path) -> None:
    made = artifact()
    made.networks["fpdnn"].train()
    made.save(tmp_path)
    assert not any(module.training for one in load(tmp_path).networks.values() for module in one.modules())


def test_everything_else_comes_back_too(tmp_path: Path) -> None:
    made = artifact()
    made.save(tmp_path)
    loaded = load(tmp_path)
    assert loaded.constants == CONSTANTS and loaded.specs == SPECS
    assert (loaded.key, loaded.data_hash, loaded.recordings, loaded.command) == (
        KEY,
        "abc",
        ("office/1/113", "office/1/213"),
        COMMAND,
    )


def test_the_folder_tells_every_part_of_the_key_apart() -> None:
    others = [
        replace(KEY, method="gnn"),
        replace(KEY, protocol="seen"),
        replace(KEY, target="mall"),
        replace(KEY, preset="full"),
        replace(KEY, seed=4),
    ]
    assert len({key.folder(Path("root")) for key in [KEY, *others]}) == 6


def test_a_missing_artifact_is_named_with_the_command_that_makes_it(tmp_path: Path) -> None:
    with pytest.raises(MissingArtifactError, match=r"gnn-fpdnn for hall.*seed 3.*make it: fploc reproduce"):
        load(tmp_path)


def test_an_artifact_of_other_data_is_refused(tmp_path: Path) -> None:
    artifact().save(tmp_path)
    with pytest.raises(MissingArtifactError, match=r"data_hash: found abc, expected xyz; make it: fploc"):
        load(tmp_path, data_hash="xyz")


def test_an_artifact_of_another_version_is_refused(tmp_path: Path) -> None:
    file = artifact().save(tmp_path) / "artifact.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"format_version": FORMAT_VERSION + 1}))
    with pytest.raises(MissingArtifactError, match=r"format_version: found 3, expected 2; make it: fploc"):
        load(tmp_path)


def test_an_artifact_in_the_place_of_another_is_refused(tmp_path: Path) -> None:
    other = replace(KEY, target="mall")
    place = other.folder(tmp_path)
    place.parent.mkdir(parents=True)
    artifact().save(tmp_path).rename(place)
    with pytest.raises(MissingArtifactError, match=r"key: found .*hall.*expected .*mall"):
        load(tmp_path, key=other)


@pytest.mark.parametrize("content", [b"{", b"", b"[1, 2]", b'"text"', b"\xff\xfe"])
def test_a_broken_description_is_refused(tmp_path: Path, content: bytes) -> None:
    (artifact().save(tmp_path) / "artifact.json").write_bytes(content)
    with pytest.raises(
        BadFileError, match=r"artifact.json, whole file.*JSON.*make it again: fploc reproduce"
    ):
        load(tmp_path)


def test_a_description_of_nothing_is_refused(tmp_path: Path) -> None:
    (artifact().save(tmp_path) / "artifact.json").write_text("{}")
    with pytest.raises(FplocError, match="make it: fploc reproduce"):
        load(tmp_path)


def test_missing_weights_are_refused(tmp_path: Path) -> None:
    (artifact().save(tmp_path) / "gnn.safetensors").unlink()
    with pytest.raises(BadFileError, match=r"gnn.safetensors, weights.*make the artifact again"):
        load(tmp_path)


@pytest.mark.parametrize("kept", [0, 7, 200, -1])
def test_truncated_weights_are_refused(tmp_path: Path, kept: int) -> None:
    file = artifact().save(tmp_path) / "gnn.safetensors"
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(BadFileError, match=r"gnn.safetensors, weights") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    folder = artifact().save(tmp_path)
    (folder / "gnn.safetensors").write_bytes((folder / "fpdnn.safetensors").read_bytes())
    with pytest.raises(
        BadFileError, match=r"gnn.safetensors.*expected the weights of fploc.models.gnn.GNN"
    ) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_network_that_no_longer_exists_is_refused(tmp_path: Path) -> None:
    file = artifact().save(tmp_path) / "artifact.json"
    file.write_text(file.read_text().replace("fploc.models.gnn.GNN", "fploc.models.gnn.OldGNN"))
    with pytest.raises(BadFileError, match="OldGNN"):
        load(tmp_path)


def test_an_older_artifact_is_replaced_whole(tmp_path: Path) -> None:
    artifact(seed=0).save(tmp_path)
    newer = artifact(seed=1, parts=("fpdnn",))
    newer.save(tmp_path)
    assert files(tmp_path) == WRITTEN - {f"{FOLDER}/gnn.safetensors"}
    newer.networks["fpdnn"].eval()
    assert torch.equal(distances(load(tmp_path)), distances(newer))


def fail_at_the_second_network(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Path] = []
    original = fploc.artifacts.save_file

    def failing(tensors: dict[str, Tensor], file: Path) -> None:
        if written:
            Path(file).write_bytes(b"half")
            raise OSError(28, "No space left on device")
        written.append(file)
        original(tensors, file)

    monkeypatch.setattr(fploc.artifacts, "save_file", failing)


def test_a_failed_save_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fail_at_the_second_network(monkeypatch)
    with pytest.raises(OSError, match="No space left"):
        artifact().save(tmp_path)
    assert files(tmp_path) == set()
    with pytest.raises(MissingArtifactError):
        load(tmp_path)


def test_a_failed_save_leaves_the_older_artifact_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    artifact(seed=0).save(tmp_path)
    before = distances(load(tmp_path))
    fail_at_the_second_network(monkeypatch)
    with pytest.raises(OSError, match="No space left"):
        artifact(seed=1).save(tmp_path)
    assert files(tmp_path) == WRITTEN
    assert torch.equal(distances(load(tmp_path)), before)


def test_constants_that_are_no_json_are_refused_before_anything_is_replaced(tmp_path: Path) -> None:
    artifact().save(tmp_path)
    with pytest.raises(TypeError):
        replace(artifact(), constants={"solver": object()}).save(tmp_path)
    assert files(tmp_path) == WRITTEN
    assert load(tmp_path).constants == CONSTANTS
