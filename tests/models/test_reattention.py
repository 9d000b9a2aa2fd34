from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn.functional import scaled_dot_product_attention

from fploc.errors import UnknownNameError
from fploc.models.layers.reattention import (
    BatchNormOfMaps,
    ReAttention,
    attention_maps,
    mix_heads,
    near_identity,
)

B, N, D, H, d = 2, 5, 7, 3, 4


def layer_of(norm: str, seed: int = 0) -> ReAttention:
    """An evaluated layer in double precision whose norm is no identity."""
    torch.manual_seed(seed)
    layer = ReAttention(D, H, d, norm=norm, qkv_bias=True).double().eval()
    for parameter in layer.norm.parameters():
        torch.nn.init.normal_(parameter, mean=1.0)
    if norm == "batch":
        layer.norm.running_mean.normal_()
        layer.norm.running_var.uniform_(0.01, 0.2)
    return layer


def tokens_of(seed: int = 1) -> Tensor:
    return torch.randn(B, N, D, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def normalised(layer: ReAttention, norm: str, values: list[float]) -> list[float]:
    """Norm of the H mixed values of one pair of tokens, from its definition."""
    if norm == "none":
        return values
    weight, bias, eps = layer.norm.weight.tolist(), layer.norm.bias.tolist(), layer.norm.eps
    if norm == "batch":
        mean, variance = layer.norm.running_mean.tolist(), layer.norm.running_var.tolist()
    else:
        centre = sum(values) / H
        mean, variance = [centre] * H, [sum((value - centre) ** 2 for value in values) / H] * H
    return [
        (values[g] - mean[g]) / math.sqrt(variance[g] + eps) * weight[g] + bias[g] for g in range(H)
    ]  # fmt: skip


def transcribed(layer: ReAttention, norm: str, tokens: Tensor) -> Tensor:
    """Norm(Θᵀ softmax(QKᵀ/√d)) V and the projection, entry by entry."""
    weight, bias, theta = layer.qkv.weight, layer.qkv.bias, layer.theta.tolist()
    result = torch.zeros(B, N, D, dtype=torch.float64)
    for b in range(B):
        rows = [(weight @ tokens[b, n] + bias).tolist() for n in range(N)]

        def part(which: int, h: int, n: int, rows: list[list[float]] = rows) -> list[float]:
            begin = (which * H + h) * d
            return rows[n][begin : begin + d]

        maps = [[[0.0] * N for _ in range(N)] for _ in range(H)]
        for h in range(H):
            for n in range(N):
                exponents = [
                    math.exp(sum(q * k for q, k in zip(part(0, h, n), part(1, h, m), strict=True)) / d**0.5)
                    for m in range(N)
                ]
                maps[h][n] = [value / sum(exponents) for value in exponents]
        for n in range(N):
            attended = [[0.0] * d for _ in range(H)]
            for m in range(N):
                # (Θᵀ A)_g = Σ_h Θ_hg A_h
                mixed = [sum(theta[h][g] * maps[h][n][m] for h in range(H)) for g in range(H)]
                for g, value in enumerate(normalised(layer, norm, mixed)):
                    for i in range(d):
                        attended[g][i] += value * part(2, g, m)[i]
            flat = torch.tensor([value for head in attended for value in head], dtype=torch.float64)
            result[b, n] = layer.proj.weight @ flat + layer.proj.bias
    return result


@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
@torch.no_grad()
def test_equals_a_direct_transcription_of_the_equation(norm: str) -> None:
    layer, tokens = layer_of(norm), tokens_of()
    layer.theta.normal_()
    everything = torch.ones(B, N, dtype=torch.bool)
    torch.testing.assert_close(layer(tokens, everything), transcribed(layer, norm, tokens))


@torch.no_grad()
def test_without_mixing_and_norm_it_is_plain_attention() -> None:
    layer, tokens = layer_of("none"), tokens_of()
    layer.theta.copy_(torch.eye(H))
    valid = torch.tensor([[True] * N, [True] * (N - 2) + [False] * 2])
    queries, keys, values = layer.qkv(tokens).reshape(B, N, 3, H, d).permute(2, 0, 3, 1, 4)
    plain = scaled_dot_product_attention(queries, keys, values, attn_mask=valid[:, None, None, :])
    expected = layer.proj(plain.transpose(1, 2).reshape(B, N, H * d))
    torch.testing.assert_close(layer(tokens, valid), expected)


@pytest.mark.parametrize("training", [False, True], ids=["evaluation", "training"])
@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
@torch.no_grad()
def test_result_does_not_depend_on_padding(norm: str, training: bool) -> None:
    layer, tokens = layer_of(norm).train(training), tokens_of()
    alone = layer(tokens, torch.ones(B, N, dtype=torch.bool))
    for padding in (1, 4):
        padded = torch.cat([tokens, 50.0 * torch.randn(B, padding, D, dtype=torch.float64)], dim=1)
        valid = torch.arange(N + padding).expand(B, -1) < N
        torch.testing.assert_close(layer(padded, valid)[:, :N], alone)


@pytest.mark.parametrize("training", [False, True], ids=["evaluation", "training"])
@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
def test_batches_together_are_one_batch(norm: str, training: bool) -> None:
    apart, padded = layer_of(norm).train(training), layer_of(norm).train(training)
    lengths = torch.tensor([2, 3, 5, 4])
    tokens = torch.randn(4, N, D, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    valid = torch.arange(N) < lengths[:, None]
    whole = padded(tokens, valid)
    parts = apart.together([tokens[:2, :3], tokens[2:]], [valid[:2, :3], valid[2:]])
    torch.testing.assert_close(parts[0][valid[:2, :3]], whole[:2][valid[:2]])
    torch.testing.assert_close(parts[1][valid[2:]], whole[2:][valid[2:]])
    whole[valid].square().sum().backward()
    sum(
        one[those].square().sum() for one, those in zip(parts, (valid[:2, :3], valid[2:]), strict=True)
    ).backward()
    for one, other in zip(apart.parameters(), padded.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad)
    for one, other in zip(apart.buffers(), padded.buffers(), strict=True):
        torch.testing.assert_close(one, other)


def test_without_padding_the_norm_of_maps_is_batch_norm() -> None:
    torch.manual_seed(0)
    ours, known = BatchNormOfMaps(H).double(), torch.nn.BatchNorm2d(H).double()
    maps = torch.rand(B, H, N, N, dtype=torch.float64)
    everything = torch.ones(B, N, dtype=torch.bool)
    for _ in range(3):
        torch.testing.assert_close(ours.together([maps], [everything])[0], known(maps))
    assert ours.state_dict().keys() == known.state_dict().keys()
    for one, other in zip(ours.buffers(), known.buffers(), strict=True):
        torch.testing.assert_close(one, other)


def test_maps_are_a_distribution_over_valid_keys() -> None:
    valid = torch.tensor([[True, False, True, True, False], [True] * 5])
    queries, keys = torch.randn(2, B, H, N, d)
    maps = attention_maps(queries, keys, valid)
    torch.testing.assert_close(maps.sum(-1), torch.ones(B, H, N))
    assert maps[0, :, :, ~valid[0]].abs().max() == 0.0


def test_heads_are_mixed_by_the_transpose_of_theta() -> None:
    maps = torch.zeros(1, 2, 1, 1)
    maps[0, 0] = 1.0
    theta = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    assert mix_heads(maps, theta).flatten().tolist() == [1.0, 2.0]


def test_theta_starts_near_the_identity() -> None:
    torch.manual_seed(0)
    theta = near_identity(8)
    assert 0.0 < (theta - torch.eye(8)).abs().max() < 0.3
    torch.testing.assert_close(near_identity(3, scale=0.0), torch.eye(3))


@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
def test_gradients_reach_every_parameter(norm: str) -> None:
    layer = layer_of(norm).train()
    valid = torch.tensor([[True] * N, [True] * (N - 1) + [False]])
    layer(tokens_of(), valid).square().sum().backward()
    for name, parameter in layer.named_parameters():
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
def test_no_links_give_no_tokens(norm: str) -> None:
    layer = layer_of(norm)
    assert layer(tokens_of()[:0], torch.ones(0, N, dtype=torch.bool)).shape == (0, N, D)


def test_unknown_norm_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'group'.*batch, layer, none"):
        ReAttention(D, H, d, norm="group")
