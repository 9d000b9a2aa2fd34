from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import yaml

import fploc.conf
from fploc.conf import instantiate, read_conf
from fploc.errors import BadFileError, UnknownNameError
from fploc.experiments.preset import (
    NETWORKS,
    SCORED_ONLY,
    Preset,
    check_preset,
    merged,
    read_ablation,
    read_preset,
)
from fploc.models.fpdnn import FPDNN, CorrectionHead, DistanceHead
from fploc.models.gnn import GNN

HEAD = {"class_path": "fploc.models.fpdnn.DistanceHead", "init_args": {"features": 64, "output": "relu"}}


@pytest.fixture
def ablate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Return what writes the ablation ``odd`` into a conf/ of the test's own."""
    (tmp_path / "ablation").mkdir()
    monkeypatch.setattr(fploc.conf, "conf_folder", lambda: tmp_path)

    def write(text: str) -> None:
        (tmp_path / "ablation" / "odd.yaml").write_text(text, encoding="utf-8")

    return write


def test_merging_goes_into_mappings_and_leaves_both_as_they_were() -> None:
    spec = {"a": {"b": 1, "c": {"d": 2}}, "e": [1, 2], "f": 3}
    changes = {"a": {"c": {"d": 5, "g": 6}}, "e": [7], "h": {"i": 8}, "f": {"j": 9}}
    before = (repr(spec), repr(changes))
    assert merged(spec, changes) == {
        "a": {"b": 1, "c": {"d": 5, "g": 6}},
        "e": [7],
        "f": {"j": 9},
        "h": {"i": 8},
    }
    assert (repr(spec), repr(changes)) == before
    assert merged(spec, {}) == spec and merged({}, changes) == changes


def test_a_merged_description_is_that_of_a_network() -> None:
    spec = merged(read_conf("model", "fpdnn"), {"init_args": {"head": HEAD, "drop": 0.0}})
    plain = read_conf("model", "fpdnn")
    assert isinstance(instantiate(FPDNN, plain).head, CorrectionHead)
    changed = instantiate(FPDNN, spec)
    assert isinstance(changed.head, DistanceHead)
    assert spec["init_args"]["vision"] == plain["init_args"]["vision"]


def test_a_variant_is_its_preset_but_for_its_name_and_the_change() -> None:
    full = read_preset("full")
    changed = {
        "plain-crops": {"sight_shares", "augmentation"},
        "measured-only": {"streams"},
        "virtual-only": {"streams"},
        "linear-solver": {"solver"},
        "access-point-index": {"network_changes"},
    }
    for ablation, expected in changed.items():
        variant = full.variant(ablation)
        assert variant.name == f"full--{ablation}"
        differing = {
            one.name for one in fields(Preset) if getattr(variant, one.name) != getattr(full, one.name)
        }
        assert differing == {"name", *expected}
        assert read_preset(f"full--{ablation}") == variant
        check_preset(f"full--{ablation}")
    assert full.variant("") is full


def test_a_network_change_reaches_the_network_and_no_other() -> None:
    full = read_preset("full")
    index = full.variant("access-point-index")
    specs, plain = index.network_specs, full.network_specs
    assert {name for name in NETWORKS if specs[name] != plain[name]} == {"gnn"}
    gnn = instantiate(GNN, specs["gnn"])
    assert gnn.index_width == 8 and instantiate(GNN, plain["gnn"]).index_width == 0


def test_changes_of_a_preset_stay_beneath_those_of_an_ablation() -> None:
    own = replace(read_preset("full"), network_changes={"gnn": {"init_args": {"hidden": 24}}})
    arguments = own.variant("access-point-index").network_specs["gnn"]["init_args"]
    assert (arguments["hidden"], arguments["index_width"]) == (24, 8)


def test_what_trains_the_same_networks_is_known() -> None:
    full = read_preset("full")
    alike = {name for name in full.ablations if full.variant(name).trains_like(full)}
    assert alike == {"linear-solver", "squared-loss"}, (
        "only the solver differs, which nothing is trained with"
    )


OTHER: dict[str, Any] = {
    "name": "other",
    "networks": {"generator": "generator", "gnn": "gnn-paper", "fpdnn": "fpdnn"},
    "solver": "lls",
    "calibration": "none",
    "labels": "published",
    "batch_intervals": 7,
    "batches_per_epoch": 7,
    "pool_batches": 7,
    "epochs": {"generator": 7, "gnn": 7, "fpdnn": 7, "gnn_adapted": 7, "fpdnn_adapted": 7},
    "learning_rates": {"generator": 0.5, "gnn": 0.5, "fpdnn": 0.5},
    "random_layout_share": 0.25,
    "validation_thin": 7,
    "streams": "virtual",
    "sight_shares": (0.5, 0.25, 0.25),
    "augmentation": {"mirror": 0.25},
    "network_changes": {"gnn": {"init_args": {"hidden": 24}}},
}
SCORED_OTHERWISE: dict[str, Any] = {
    "seeds": (7, 8),
    "protocols": {"seen": ("office",)},
    "methods": ("magic",),
    "ablations": ("magic",),
    "ablation_targets": ("moon",),
    "ablation_seeds": (7,),
    "synthesized": ("moon",),
    "plans": ("moon",),
    "thins": (7,),
    "calibrations": ("magic",),
    "access_point_counts": (7,),
    "survey_errors_m": (7.0,),
    "studied_thin": 7,
}


def test_every_key_of_a_preset_is_checked_here() -> None:
    assert {one.name for one in fields(Preset)} == set(OTHER) | set(SCORED_OTHERWISE)
    assert set(SCORED_OTHERWISE) == set(SCORED_ONLY)


@pytest.mark.parametrize("key", SCORED_OTHERWISE)
def test_what_is_scored_leaves_the_fingerprint(key: str) -> None:
    full = read_preset("full")
    changed = replace(full, **{key: SCORED_OTHERWISE[key]})
    assert changed != full and changed.fingerprint == full.fingerprint


@pytest.mark.parametrize("key", OTHER)
def test_what_is_trained_changes_the_fingerprint(key: str) -> None:
    full = read_preset("full")
    assert replace(full, **{key: OTHER[key]}).fingerprint != full.fingerprint


def test_the_contents_of_a_network_file_change_the_fingerprint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    preset = read_preset("smoke")
    before = preset.fingerprint
    (tmp_path / "model").mkdir()
    for name in NETWORKS:
        spec = read_conf("model", name)
        if name == "gnn":
            spec["init_args"]["layers"] += 1
        (tmp_path / "model" / f"{name}.yaml").write_text(yaml.safe_dump(spec), encoding="utf-8")
    monkeypatch.setattr(fploc.conf, "conf_folder", lambda: tmp_path)
    assert preset.fingerprint != before


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("reason: x\nlayers: 3\n", "layers"),
        ("solver: lls\n", "reason"),
        ("reason: x\nsolver: magic\n", "magic"),
        ("reason: x\nstreams: none\n", "streams"),
        ("reason: x\nsight_shares: [0.5, 0.5]\n", "sight_shares"),
        ("reason: x\nnetworks: {cnn: {init_args: {}}}\n", "cnn"),
        ("reason: x\nnetworks: [gnn]\n", "networks"),
        ("reason: x\nnetworks: {gnn: {}, cnn: {}}\n", "changes of generator, gnn, fpdnn"),
    ],
)
def test_what_an_ablation_cannot_say_is_named_with_its_file(
    text: str, named: str, ablate: Callable[[str], None]
) -> None:
    ablate(text)
    with pytest.raises(BadFileError) as refused:
        read_ablation("odd")
    told = str(refused.value)
    assert told.startswith("conf/ablation/odd.yaml") and named in told and "\n" not in told


def test_descriptions_of_classes_in_an_ablation_stay_descriptions(ablate: Callable[[str], None]) -> None:
    ablate(yaml.safe_dump({"reason": "x", "networks": {"fpdnn": {"init_args": {"head": HEAD}}}}))
    assert read_ablation("odd").networks == {"fpdnn": {"init_args": {"head": HEAD}}}


@pytest.mark.parametrize("read", [read_preset, check_preset])
def test_unknown_presets_and_ablations_are_told_with_the_known_ones(read: Callable[[str], object]) -> None:
    with pytest.raises(UnknownNameError, match=r"'tiny', expected one of .*smoke"):
        read("tiny")
    with pytest.raises(UnknownNameError, match=r"'magic', expected one of .*bare-distance"):
        read("full--magic")
