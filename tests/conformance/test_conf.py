"""Every YAML of conf/ through the code that reads it."""

from __future__ import annotations

import re
import shlex

import pytest
import torch

from fploc.commands.registry import make_parser
from fploc.conf import conf_folder, instantiate, read_conf
from fploc.evaluation.protocols import PROTOCOLS, protocol_of
from fploc.experiments.preset import NETWORKS, PRESETS, read_ablation, read_preset
from fploc.experiments.scoring import METHODS, PLANS, range_solver
from fploc.floorplan.raster import PlanRaster
from fploc.graphs.radio_graph import radio_graph
from fploc.intervals import Intervals
from fploc.methods.registry import SOURCE_FITTED_METHODS, geometric_method
from fploc.models.deepvit import CROP_WIDTH_M, DeepViT
from fploc.models.fpdnn import FPDNN, Sight
from fploc.models.generator import Generator
from fploc.models.gnn import GNN
from fploc.serve.settings import ServeSettings
from fploc.sites.registry import known_sites

LONGEST_LINK_M = 40.0
HELD_OUT = {"canteen", "carpark"}


def names(group: str) -> list[str]:
    files = [entry.name for entry in (conf_folder() / group).iterdir()]
    assert all(name.endswith(".yaml") for name in files)
    return sorted(name.removesuffix(".yaml") for name in files)


def made(name: str) -> torch.nn.Module:
    torch.manual_seed(0)
    return instantiate(torch.nn.Module, read_conf("model", name)).eval()


def parameters(network: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def check_crops(vision: DeepViT) -> tuple[torch.Tensor, torch.Tensor]:
    """Return images and lengths of one link of 1.3 m, at the network's own resolution."""
    crops = vision.crops
    assert crops.pixels_per_metre * CROP_WIDTH_M == vision.crop_height_px
    assert crops.max_length_px / crops.pixels_per_metre >= LONGEST_LINK_M
    plan = PlanRaster(
        ink=torch.eye(60), pixels_from_metres=torch.tensor([[10.0, 0.0, 0.0], [0.0, -10.0, 59.0]])
    )
    cropped = crops.crop(plan, torch.tensor([[2.0, 3.0]]), torch.tensor([[3.3, 3.0]]))
    assert cropped.images.shape[-2] == vision.crop_height_px
    return cropped.images, cropped.lengths_px


@pytest.mark.parametrize("name", names("model"))
def test_every_model_runs_on_input_of_its_own_size(name: str) -> None:
    check_runs(made(name))


@torch.no_grad()
def check_runs(network: torch.nn.Module) -> None:
    match network:
        case FPDNN():
            images, lengths_px = check_crops(network.vision)
            sight = torch.tensor([Sight.PLAN])
            distances = network(images, lengths_px, torch.tensor([2.0]), torch.tensor([-50.0]), sight)
            assert distances.shape == (1,) and float(distances) >= 0
        case Generator():
            images, lengths_px = check_crops(network.vision)
            errors, rss = network(images, lengths_px, torch.tensor([1.3])).sample(torch.Generator())
            assert torch.isfinite(torch.cat([errors, rss])).all()
        case GNN():
            access_points = torch.tensor([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])
            heard = torch.tensor([[True, True, True], [True, False, False]])
            intervals = Intervals(
                t_s=torch.zeros(2, dtype=torch.float64),
                ranges=3.0 * heard,
                stds=torch.zeros(2, 3),
                rss=-50.0 * heard,
                heard=heard,
                present=torch.ones(2, dtype=torch.bool),
            )
            positions = network(radio_graph(intervals, access_points, torch.ones(2, 2)))
            assert positions.shape == (2, 2) and torch.isfinite(positions).all()
        case _:
            pytest.fail(f"no check for {type(network).__name__} in this test")


def test_paper_networks_have_the_published_sizes() -> None:
    fpdnn = made("fpdnn-paper")
    assert isinstance(fpdnn, FPDNN)
    vision = fpdnn.vision
    assert vision.crops.pixels_per_metre == 64.0 and vision.patch_px == (32, 32)
    assert (vision.embed.in_features, vision.embed.out_features) == (1024, 512)
    (block,) = vision.blocks
    assert (block.attention.num_heads, block.attention.head_dim) == (2, 64)
    assert vision.head[1].out_features == 32 and fpdnn.ffnn1[0].in_features == 2
    generator = made("generator-paper")
    assert isinstance(generator, Generator)
    assert parameters(generator.vision) == parameters(vision)


def test_small_networks_are_smaller_than_the_published_ones() -> None:
    for name in ("fpdnn", "generator"):
        assert 10 * parameters(made(name)) < parameters(made(f"{name}-paper"))


@pytest.mark.parametrize("name", names("method"))
def test_every_method_file_is_that_of_a_method(name: str) -> None:
    described = read_conf("method", name)
    assert described.keys() == {"class_path", "init_args"}
    method = SOURCE_FITTED_METHODS[name]() if name in SOURCE_FITTED_METHODS else geometric_method(name)
    assert method.name == name


@pytest.mark.parametrize("name", names("serve"))
def test_settings_of_the_server_are_read(name: str) -> None:
    settings = ServeSettings.read(name)
    assert 0 < settings.tick_ms <= settings.silent_ms < settings.forget_ms
    assert 0 < settings.compute_share < 1


@pytest.mark.parametrize("name", names("preset"))
def test_every_preset_is_read_and_names_what_exists(name: str) -> None:
    preset = read_preset(name)
    assert preset.name == name
    kinds = {part: instantiate(torch.nn.Module, spec) for part, spec in preset.network_specs.items()}
    assert {part: type(network) for part, network in kinds.items()} == {
        "generator": Generator,
        "gnn": GNN,
        "fpdnn": FPDNN,
    }
    assert callable(range_solver(preset.solver))
    assert preset.labels in {"published", "repaired"}
    assert len(preset.protocols) == len(set(preset.protocols)) > 0
    for protocol, sites in preset.protocols.items():
        assert len(set(sites)) == len(sites) > 0
        assert set(sites) <= set(known_sites()) - HELD_OUT
        for site in sites:
            protocol_of(protocol).check_target(site)
    assert set(preset.plans) <= {*PLANS, *known_sites()} - {"real", *HELD_OUT}
    assert set(preset.synthesized) <= set(known_sites()) - HELD_OUT
    assert set(preset.methods) <= set(METHODS) and len(set(preset.methods)) == len(preset.methods) > 0
    assert set(preset.epochs) == {"generator", "gnn", "fpdnn", "gnn_adapted", "fpdnn_adapted"}
    assert set(preset.learning_rates) == {"generator", "gnn", "fpdnn"}
    counts = [
        *preset.seeds,
        *preset.epochs.values(),
        preset.batch_intervals,
        preset.batches_per_epoch,
        *preset.thins,
    ]
    assert all(type(count) is int for count in counts) and min(preset.epochs.values()) > 0
    assert all(count > 0 for count in preset.thins)
    for listed in (preset.seeds, preset.thins, preset.plans, preset.ablations, preset.synthesized):
        assert len(set(listed)) == len(listed)
    assert preset.seeds and preset.thins
    assert set(preset.ablation_seeds) <= set(preset.seeds)
    assert set(preset.ablation_targets) <= set(preset.protocols.get("zero-shot", ()))
    assert sum(preset.sight_shares) == pytest.approx(1.0) and min(preset.sight_shares) >= 0.0
    assert 0.0 <= preset.random_layout_share <= 1.0
    assert all(0 < rate < 1 for rate in preset.learning_rates.values())


def first_command(group: str, name: str) -> list[str]:
    first = (conf_folder() / group / f"{name}.yaml").read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("# ")
    return shlex.split(first.removeprefix("# "))


@pytest.mark.parametrize("name", names("preset"))
def test_every_preset_begins_with_the_command_that_runs_it(name: str) -> None:
    words = first_command("preset", name)
    assert words[:4] == ["fploc", "reproduce", "--preset", name]
    assert make_parser().parse_args(words[1:]).reproduce.preset == name


@pytest.mark.parametrize("name", names("experiment"))
def test_every_experiment_begins_with_the_command_that_runs_it(name: str) -> None:
    assert first_command("experiment", name) == ["fploc", "fit", "--config", f"conf/experiment/{name}.yaml"]


def test_presets_are_what_reproduce_runs() -> None:
    assert set(PRESETS) == set(names("preset"))


def test_fingerprints_tell_presets_apart_and_stay() -> None:
    prints = [read_preset(name).fingerprint for name in PRESETS]
    assert len(set(prints)) == len(PRESETS)
    assert prints == [read_preset(name).fingerprint for name in PRESETS]


@pytest.mark.parametrize("name", names("ablation"))
def test_every_ablation_says_in_one_sentence_what_it_shows_and_changes_what_it_says(name: str) -> None:
    full = read_preset("full")
    change, said = read_ablation(name), read_conf("ablation", name)
    assert re.fullmatch(r"[A-Z].*[^ .]\.", change.reason) and ". " not in change.reason, "one sentence"
    assert len(said) > 1, "a reason and at least one change"
    variant = full.variant(name)
    for key in set(said) - {"reason", "networks"}:
        assert getattr(variant, key) == getattr(change, key) != getattr(full, key)
    specs, plain = variant.network_specs, full.network_specs
    assert {part for part in NETWORKS if specs[part] != plain[part]} == set(said.get("networks", {}))
    unsaid = {"solver", "streams", "sight_shares", "augmentation"} - set(said)
    assert all(getattr(variant, key) == getattr(full, key) for key in unsaid)
    assert variant.fingerprint != full.fingerprint


@pytest.mark.parametrize("name", names("ablation"))
def test_every_ablation_makes_networks_that_run(name: str) -> None:
    torch.manual_seed(0)
    for spec in read_preset("full").variant(name).network_specs.values():
        check_runs(instantiate(torch.nn.Module, spec).eval())


def test_full_trains_every_ablation_and_every_protocol() -> None:
    full = read_preset("full")
    assert set(full.ablations) == set(names("ablation"))
    assert set(full.protocols) == {one.name for one in PROTOCOLS}


def test_paper_preset_trains_as_published() -> None:
    preset = read_preset("paper")
    assert {preset.epochs[name] for name in ("generator", "gnn", "fpdnn")} == {50}
    assert preset.solver == "lls"
    assert preset.learning_rates == {"generator": 1e-3, "gnn": 2e-4, "fpdnn": 1e-3}
