from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

import fploc.conf
from fploc.conf import conf_folder, instantiate, read_conf
from fploc.errors import BadFileError, FplocError, UnknownNameError
from fploc.experiments.preset import read_preset
from fploc.models.fpdnn import FPDNN, CorrectionHead
from fploc.models.gnn import GNN

GNN_SPEC = {"class_path": "fploc.models.gnn.GNN", "init_args": {"hidden": 8, "message_width": 2, "layers": 1}}
VISION_SPEC: dict[str, Any] = {
    "class_path": "fploc.models.deepvit.DeepViT",
    "init_args": {
        "crop_height_px": 20,
        "max_length_px": 100,
        "patch_px": [20, 10],
        "dim": 8,
        "depth": 1,
        "num_heads": 2,
        "head_dim": 4,
    },
}


@pytest.fixture
def own_conf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A conf/ folder of the test's own, with the groups ``model`` and ``experiment``."""
    for group in ("model", "preset"):
        (tmp_path / group).mkdir()
    monkeypatch.setattr(fploc.conf, "conf_folder", lambda: tmp_path)
    return tmp_path


def test_conf_folder_holds_both_groups() -> None:
    for group in ("model", "preset"):
        assert (conf_folder() / group).is_dir()


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"conf/model: found 'gnm', expected one of .*gnn, gnn-paper"):
        read_conf("model", "gnm")


@pytest.mark.parametrize("text", ["- a\n- b\n", "", "3\n"])
def test_a_file_that_is_no_mapping_is_refused(own_conf: Path, text: str) -> None:
    (own_conf / "model" / "odd.yaml").write_text(text)
    with pytest.raises(BadFileError, match=r"conf/model/odd.yaml.*expected a mapping"):
        read_conf("model", "odd")


@pytest.mark.parametrize("content", [b"a: [1, 2\n", b"a: b: c\n", b"\xff\xfe\x00"])
def test_a_file_that_is_no_yaml_is_refused(own_conf: Path, content: bytes) -> None:
    (own_conf / "model" / "broken.yaml").write_bytes(content)
    with pytest.raises(BadFileError, match=r"conf/model/broken.yaml.*expected YAML"):
        read_conf("model", "broken")


def test_a_spec_becomes_its_object() -> None:
    gnn = instantiate(GNN, GNN_SPEC)
    assert isinstance(gnn, GNN) and gnn.layers == 1


def test_nested_specs_become_nested_objects() -> None:
    head = {"class_path": "fploc.models.fpdnn.CorrectionHead", "init_args": {"features": 64}}
    spec = {
        "class_path": "fploc.models.fpdnn.FPDNN",
        "init_args": {"vision": VISION_SPEC, "head": head, "drop": 0.1},
    }
    fpdnn = instantiate(FPDNN, spec)
    assert isinstance(fpdnn.head, CorrectionHead)
    assert fpdnn.vision.patch_px == (20, 10) and fpdnn.vision.embed.out_features == 8


def changed(spec: dict[str, Any], **arguments: Any) -> dict[str, Any]:
    kept = {name: value for name, value in (spec["init_args"] | arguments).items() if value is not None}
    return spec | {"init_args": kept}


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        (changed(GNN_SPEC, depth=3), "depth"),
        (changed(GNN_SPEC, hidden=None), "hidden"),
        (changed(GNN_SPEC, hidden="eight"), "hidden"),
        (GNN_SPEC | {"class_path": "fploc.models.gnn.GMM"}, "GMM"),
        (GNN_SPEC | {"class_path": "fploc.models.deepvit.EncoderBlock"}, "EncoderBlock"),
        (changed(VISION_SPEC, patch_px=[20, 10, 5]), "patch_px"),
    ],
)
def test_wrong_specs_are_refused_by_name(spec: dict[str, Any], named: str) -> None:
    kind = torch.nn.Module if spec.get("class_path") == VISION_SPEC["class_path"] else GNN
    with pytest.raises(BadFileError, match=named) as caught:
        instantiate(kind, spec)
    assert "\n" not in str(caught.value) and "init_args" in str(caught.value)


def test_errors_of_the_class_itself_come_through() -> None:
    with pytest.raises(UnknownNameError, match="norm of re-attention: found 'group'"):
        instantiate(torch.nn.Module, changed(VISION_SPEC, attention_norm="group"))


@pytest.mark.parametrize("patch_px", [[20, 7], [6, 10]])
def test_patches_that_do_not_divide_the_crop_are_refused(patch_px: list[int]) -> None:
    with pytest.raises(
        FplocError, match=r"patch_px of DeepViT: found .* expected divisors of crop_height_px 20"
    ):
        instantiate(torch.nn.Module, changed(VISION_SPEC, patch_px=patch_px))


def test_unknown_preset_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'huge'.*default, full, paper, published, smoke"):
        read_preset("huge")


@pytest.mark.parametrize(
    ("text", "named"), [("seeds: [0]\n", "solver"), ("colour: red\n", "colour"), ("{}\n", "seeds")]
)
def test_missing_and_unknown_keys_of_a_preset_are_named(own_conf: Path, text: str, named: str) -> None:
    (own_conf / "preset" / "mine.yaml").write_text(text)
    with pytest.raises(BadFileError, match=rf"conf/preset/mine.yaml, .*{named}"):
        read_preset("mine")
