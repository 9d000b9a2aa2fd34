from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.errors import UnknownNameError
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.raster import PlanRaster
from fploc.intervals import Intervals, NoFix
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import (
    FPDNN,
    RANGE_SCALE_M,
    CorrectionHead,
    DistanceHead,
    Sight,
    ffnn,
    normalised_measurement,
)
from fploc.models.gnn import GNN
from fploc.sites.site import AccessPoint, Site
from fploc.solvers.nonlinear import solve_nonlinear

CORNERS = ((0.0, 0.0), (12.0, 1.0), (11.0, 9.0), (1.0, 10.0))


def network(head: torch.nn.Module) -> FPDNN:
    torch.manual_seed(0)
    vision = DeepViT(
        crop_height_px=8, max_length_px=40, patch_px=(8, 4), dim=8, depth=1, num_heads=2, head_dim=4
    )
    return FPDNN(vision, head).eval()


def links(number: int, sight: Sight = Sight.PLAN) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    random = torch.Generator().manual_seed(2)
    images = torch.rand(number, 1, 8, 40, generator=random)
    lengths_px = torch.randint(1, 41, (number,), generator=random)
    ranges, rss = 30 * torch.rand(number, generator=random), torch.full((number,), -70.0)
    return images, lengths_px, ranges, rss, torch.full((number,), int(sight))


@torch.no_grad()
def test_correction_starts_as_no_correction() -> None:
    images, lengths_px, ranges, rss, sight = links(9)
    assert torch.equal(network(CorrectionHead(64))(images, lengths_px, ranges, rss, sight), ranges)


@torch.no_grad()
def test_correction_is_subtracted_and_ends_at_zero() -> None:
    head = CorrectionHead(3)
    head.layers[-1].bias.fill_(2.0)
    assert head(torch.rand(3, 3), torch.tensor([0.5, 2.0, 7.0])).tolist() == [0.0, 0.0, 5.0]


def test_correction_can_be_learned_from_its_start() -> None:
    head = CorrectionHead(3)
    head(torch.rand(5, 3), torch.full((5,), 4.0)).square().sum().backward()
    assert head.layers[-1].weight.grad.abs().max() > 0


def test_bare_distance_is_never_negative_and_keeps_its_gradient() -> None:
    torch.manual_seed(0)
    head = DistanceHead(16)
    features = (100 * torch.randn(400, 16)).requires_grad_()
    distances = head(features, torch.zeros(400))
    assert distances.shape == (400,) and distances.min() >= 0
    with torch.no_grad():
        head.layers[-2].bias.fill_(-3.0)
    negative = head(features, torch.zeros(400))
    negative.sum().backward()
    assert features.grad.abs().sum(-1).min() > 0


@pytest.mark.parametrize(
    ("output", "expected"),
    [("softplus", [0.0, 0.693147, 2.126928]), ("relu", [0, 0, 2]), ("none", [-30, 0, 2])],
)
@torch.no_grad()
def test_last_layer_of_the_bare_distance_is_as_asked_for(output: str, expected: list[float]) -> None:
    head = DistanceHead(1, hidden=1, output=output)
    *_, last, _ = head.layers
    last.weight.zero_()
    found = []
    for bias in (-30.0, 0.0, 2.0):
        last.bias.fill_(bias)
        found.append(float(head(torch.ones(1, 1), torch.zeros(1))) / RANGE_SCALE_M)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_an_unknown_last_layer_is_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"softplus, relu, none; correct `output`"):
        DistanceHead(16, output="tanh")


@pytest.mark.parametrize("head", [CorrectionHead, DistanceHead])
@torch.no_grad()
def test_order_of_links_does_not_matter(head: type[torch.nn.Module]) -> None:
    fpdnn = network(head(64))
    torch.nn.init.normal_(fpdnn.head.layers[2].weight)
    inputs = links(8)
    turned = torch.randperm(8, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(fpdnn(*(part[turned] for part in inputs)), fpdnn(*inputs)[turned])


@torch.no_grad()
def test_distance_depends_on_crop_range_and_signal_strength() -> None:
    fpdnn = network(DistanceHead(64))
    images, lengths_px, ranges, rss, sight = links(1)
    distance = fpdnn(images, lengths_px, ranges, rss, sight)
    for changed in (
        (1 - images, lengths_px, ranges, rss),
        (images, lengths_px, ranges + 5, rss),
        (images, lengths_px, ranges, rss + 20),
    ):
        assert not torch.allclose(fpdnn(*changed, sight), distance)


@pytest.mark.parametrize(
    ("sight", "by_image", "by_length"),
    [(Sight.PLAN, True, True), (Sight.LENGTH, False, True), (Sight.NOTHING, False, False)],
)
@torch.no_grad()
def test_distance_depends_on_what_a_link_is_given_of_the_plan(
    sight: Sight, by_image: bool, by_length: bool
) -> None:
    fpdnn = network(DistanceHead(64))
    images, _, *measured = links(1, sight)
    at_20 = fpdnn(images, torch.tensor([20]), *measured)
    assert torch.equal(fpdnn(1 - images, torch.tensor([20]), *measured), at_20) != by_image
    assert torch.equal(fpdnn(images, torch.tensor([33]), *measured), at_20) != by_length


@torch.no_grad()
def test_length_is_seen_in_metres() -> None:
    """40 m at a pixel per 0.5 m: one network on crops of other resolutions sees the same."""
    seen: list[Tensor] = []
    fpdnn = network(DistanceHead(64))
    fpdnn.length_ffnn.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    images, _, *measured = links(2, Sight.LENGTH)
    fpdnn(images, torch.tensor([20, 40]), *measured)
    assert fpdnn.vision.crops.pixels_per_metre == 2.0
    assert seen[0].tolist() == [[0.0], [1.0]]


@torch.no_grad()
def test_links_of_one_batch_may_see_differently_and_do_not_disturb_each_other() -> None:
    fpdnn = network(DistanceHead(64))
    images, lengths_px, ranges, rss, _ = links(7)
    sight = torch.tensor([0, 1, 2, 0, 2, 1, 0])
    together = fpdnn(images, lengths_px, ranges, rss, sight)
    for kind in Sight:
        one = sight == kind
        alone = fpdnn(images[one], lengths_px[one], ranges[one], rss[one], sight[one])
        torch.testing.assert_close(together[one], alone)


@torch.no_grad()
def test_deepvit_runs_on_links_that_look_and_no_other() -> None:
    fpdnn = network(DistanceHead(64))
    sizes: list[int] = []
    fpdnn.vision.register_forward_pre_hook(lambda _, inputs: sizes.append(len(inputs[0])))
    images, lengths_px, ranges, rss, _ = links(5)
    fpdnn(images, lengths_px, ranges, rss, torch.tensor([1, 0, 2, 0, 0]))
    fpdnn(images, lengths_px, ranges, rss, torch.full((5,), int(Sight.NOTHING)))
    assert sizes == [3]


def test_gradients_reach_every_parameter_from_all_three_sights() -> None:
    fpdnn = network(DistanceHead(64)).train()
    images, lengths_px, ranges, rss, _ = links(6)
    fpdnn(images, lengths_px, ranges, rss, torch.tensor([0, 1, 2] * 2)).sum().backward()
    for name, parameter in fpdnn.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
    assert fpdnn.nothing.grad.abs().max() > 0 and fpdnn.length_ffnn[0].weight.grad.abs().max() > 0


def test_measurement_is_centred_and_scaled() -> None:
    scaled = normalised_measurement(torch.tensor([10.0, 30.0]), torch.tensor([-65.0, -85.0]))
    assert scaled.tolist() == [[0.0, 0.0], [2.0, -2.0]]


@pytest.mark.parametrize(
    ("vision", "head"),
    [
        ({"attention_norm": "batch"}, None),
        ({"attention_norm": "layer"}, None),
        ({"attention_norm": "none"}, None),
        ({"crop_height_px": 40, "max_length_px": 400, "patch_px": [40, 20]}, None),
        (
            {},
            {
                "class_path": "fploc.models.fpdnn.DistanceHead",
                "init_args": {"features": 64, "output": "relu"},
            },
        ),
    ],
)
def test_what_is_compared_can_be_asked_for_in_a_configuration(
    vision: dict[str, Any], head: dict[str, Any] | None
) -> None:
    spec = copy.deepcopy(read_conf("model", "fpdnn"))
    spec["init_args"]["vision"]["init_args"] |= vision
    spec["init_args"]["head"] = head or spec["init_args"]["head"]
    fpdnn = instantiate(FPDNN, spec)
    plan = PlanRaster(torch.rand(120, 140), torch.tensor([[10.0, 0, 5], [0, -10.0, 110]]))
    crops = fpdnn.vision.crops.crop(
        plan, torch.zeros(3, 2), torch.tensor([[9.0, 1.0], [3.0, 8.0], [0.1, 0.0]])
    )
    fpdnn(crops.images, crops.lengths_px, *links(3)[2:]).square().sum().backward()
    assert fpdnn.vision.crops.max_length_px / fpdnn.vision.crops.pixels_per_metre == 40.0
    assert all(torch.isfinite(p.grad).all() for p in fpdnn.parameters() if p.grad is not None)


def test_ffnn1_has_the_published_layers() -> None:
    kinds = [type(layer).__name__ for layer in ffnn(2, 64, 32, 0.2)]
    assert kinds == ["Linear", "ReLU", "LayerNorm", "Linear", "ReLU", "Dropout"]
    first, second = (layer for layer in ffnn(2, 64, 32, 0.2) if isinstance(layer, torch.nn.Linear))
    assert (first.in_features, first.out_features, second.out_features) == (2, 64, 32)


def chain(head: torch.nn.Module, sight: Sight = Sight.PLAN) -> GNNFPDNN:
    fpdnn = network(head)
    plan = PlanRaster(
        ink=torch.zeros(120, 140), pixels_from_metres=torch.tensor([[10.0, 0, 5], [0, -10.0, 110]])
    )
    return GNNFPDNN(
        GNNMethod(GNN(hidden=8, message_width=2, layers=1).eval(), variance_m2=1.0),
        fpdnn,
        plan,
        fpdnn.vision.crops,
        solve_nonlinear,
        sigma_m=0.5,
        filter_settings=KalmanSettings(),
        sight=sight,
    )


def site() -> Site:
    points = tuple(
        AccessPoint(f"AP{i}", f"00:00:00:00:00:0{i}", x, y, 2.0) for i, (x, y) in enumerate(CORNERS)
    )
    return Site("hall", "hall", points, device_height_m=2.0)


def noise_free(truth: Tensor, heard: Tensor) -> Intervals:
    ranges = (truth[:, None] - torch.tensor(CORNERS)).norm(dim=-1) * heard
    return Intervals(
        t_s=torch.zeros(len(truth), dtype=torch.float64),
        ranges=ranges,
        stds=torch.zeros_like(ranges),
        rss=-60.0 * heard,
        heard=heard,
        present=torch.ones(len(truth), dtype=torch.bool),
    )


def test_chain_gives_back_positions_from_noise_free_ranges() -> None:
    truth = torch.tensor([[3.0, 4.0], [6.0, 2.0], [9.0, 8.0], [5.0, 5.0]])
    heard = torch.tensor([[True] * 4, [True, True, True, False], [True, False, False, False], [False] * 4])
    method = chain(CorrectionHead(64))
    _, found = method.step(method.init(site(), 4), noise_free(truth, heard))
    assert found.reasons.tolist() == [NoFix.FIXED, NoFix.FIXED, NoFix.TOO_FEW_RANGES, NoFix.NO_READING]
    np.testing.assert_allclose(found.positions[:2], truth[:2], atol=1e-4)
    assert found.positions[2:].isnan().all()


def test_chain_corrects_heard_ranges_of_devices_with_a_coarse_position_only() -> None:
    truth = torch.tensor([[3.0, 4.0], [6.0, 2.0]])
    heard = torch.tensor([[True, True, False, True], [True, True, False, False]])
    method = chain(CorrectionHead(64))
    with torch.no_grad():
        method.network.head.layers[-1].bias.fill_(0.5)
    intervals = noise_free(truth, heard)
    state = method.init(site(), 2)
    _, coarse = method.coarse.step(state.access_points, intervals)
    assert coarse.fixed.tolist() == [True, False]
    with torch.no_grad():
        corrected = method.corrected_ranges(intervals, state.access_points, coarse)
    expected = intervals.ranges.double()
    expected[0] -= 0.5 * heard[0]
    np.testing.assert_allclose(corrected, expected, atol=1e-6)


@pytest.mark.parametrize("sight", Sight)
@torch.no_grad()
def test_chain_gives_fpdnn_what_it_is_asked_to_see(sight: Sight) -> None:
    method = chain(DistanceHead(64), sight)
    seen: list[Tensor] = []
    method.network.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[-1]))
    truth = torch.tensor([[3.0, 4.0], [6.0, 2.0]])
    method.step(method.init(site(), 2), noise_free(truth, torch.ones(2, 4, dtype=torch.bool)))
    assert [one.tolist() for one in seen] == [[sight] * 8]


def test_chain_without_any_reading_finds_nothing() -> None:
    method = chain(CorrectionHead(64))
    _, found = method.step(
        method.init(site(), 2), noise_free(torch.ones(2, 2), torch.zeros(2, 4, dtype=torch.bool))
    )
    assert found.reasons.tolist() == [NoFix.NO_READING] * 2
