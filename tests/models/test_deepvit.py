from __future__ import annotations

import pytest
import torch
from torch import Tensor

from fploc.models.deepvit import CROPS_AT_ONCE, DeepViT, split_and_flatten, valid_columns

HEIGHT, PATCH = 8, (4, 5)


def network(norm: str = "batch", depth: int = 2) -> DeepViT:
    torch.manual_seed(0)
    made = DeepViT(
        crop_height_px=HEIGHT,
        max_length_px=40,
        patch_px=PATCH,
        dim=12,
        depth=depth,
        num_heads=2,
        head_dim=4,
        mlp_ratio=2.0,
        features=6,
        attention_norm=norm,
        drop=0.0,
    ).eval()
    # Statistics as after a training, so that padding could be seen if it got in.
    for module in made.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.uniform_(0.0, 0.3)
            module.running_var.uniform_(0.02, 0.2)
    return made


def crops(lengths: list[int], width: int, seed: int = 1) -> tuple[Tensor, Tensor]:
    """Drawings that end at their lengths, as ``crop_links`` makes them."""
    images = torch.rand(len(lengths), 1, HEIGHT, width, generator=torch.Generator().manual_seed(seed))
    lengths_px = torch.tensor(lengths)
    return images * (torch.arange(width) < lengths_px[:, None])[:, None, None, :], lengths_px


def test_patches_are_flattened_row_by_row() -> None:
    """The paper's s = [I_11, I_12, …, I_1P, I_21, …, I_PP] of each mini-image."""
    image = torch.arange(HEIGHT * 15, dtype=torch.float32).reshape(1, 1, HEIGHT, 15)
    patches = split_and_flatten(image, PATCH)
    assert patches.shape == (1, 2, 3, 20)
    for row in range(2):
        for column in range(3):
            expected = [float(image[0, 0, row * 4 + i, column * 5 + j]) for i in range(4) for j in range(5)]
            assert patches[0, row, column].tolist() == expected


def test_a_patch_column_is_valid_where_it_starts_inside_the_crop() -> None:
    valid = valid_columns(torch.tensor([0, 1, 5, 6, 15, 99]), 5, 3)
    assert valid.tolist() == [
        [True, False, False],
        [True, False, False],
        [True, False, False],
        [True, True, False],
        [True, True, True],
        [True, True, True],
    ]


@pytest.mark.parametrize("training", [False, True], ids=["evaluation", "training"])
@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
@torch.no_grad()
def test_padding_further_changes_nothing(norm: str, training: bool) -> None:
    vision = network(norm).train(training)
    images, lengths_px = crops([3, 10, 17, 20], 20)
    expected = vision(images, lengths_px)
    assert expected.std(0).max() > 0
    for width in (25, 40):
        padded = torch.nn.functional.pad(images, (0, width - 20))
        torch.testing.assert_close(vision.encoded([padded], [lengths_px])[0], expected)


@torch.no_grad()
def test_in_evaluation_crops_do_not_depend_on_each_other() -> None:
    vision = network()
    images, lengths_px = crops([3, 10, 17, 20], 20)
    alone = vision(images[:1, :, :, :5], lengths_px[:1])
    torch.testing.assert_close(alone, vision(images, lengths_px)[:1])


@torch.no_grad()
def test_ink_in_padded_columns_is_not_seen() -> None:
    vision = network()
    images, lengths_px = crops([5, 12], 20)
    scribbled = images.clone()
    scribbled[0, :, :, 5:] = 1.0
    scribbled[1, :, :, 15:] = 1.0
    torch.testing.assert_close(vision(scribbled, lengths_px), vision(images, lengths_px))
    scribbled[0, :, :, :5] = 1.0
    assert not torch.allclose(vision(scribbled, lengths_px)[0], vision(images, lengths_px)[0])


@pytest.mark.parametrize("training", [False, True], ids=["evaluation", "training"])
@pytest.mark.parametrize("norm", ["batch", "layer", "none"])
@torch.no_grad()
def test_crops_that_go_in_several_parts_keep_their_features_and_order(norm: str, training: bool) -> None:
    vision = network(norm).double().train(training)
    lengths = torch.randint(0, 41, (3 * CROPS_AT_ONCE + 5,), generator=torch.Generator().manual_seed(4))
    images, lengths_px = crops(lengths.tolist(), 40)
    images = images.double()
    torch.testing.assert_close(vision(images, lengths_px), vision.encoded([images], [lengths_px])[0])


@torch.no_grad()
def test_short_crops_are_not_padded_to_the_longest(monkeypatch: pytest.MonkeyPatch) -> None:
    vision = network()
    widths: list[int] = []
    tokens = vision.tokens

    def watched(images: Tensor, lengths_px: Tensor) -> tuple[Tensor, Tensor]:
        widths.append(images.shape[-1])
        return tokens(images, lengths_px)

    monkeypatch.setattr(vision, "tokens", watched)
    lengths = [40, *[0] * CROPS_AT_ONCE, *[12] * (CROPS_AT_ONCE - 1)]
    vision(*crops(lengths, 40))
    assert widths == [PATCH[1], 40]


def test_mean_is_over_valid_patches_without_the_class_token() -> None:
    tokens = torch.tensor([[[1e9], [1.0], [2.0], [6.0], [1e9]], [[1e9], [5.0], [1e9], [1e9], [1e9]]])
    valid = torch.tensor([[True, True, True, True, False], [True, True, False, False, False]])
    assert DeepViT.mean_over_patches(tokens, valid).flatten().tolist() == [3.0, 5.0]


@torch.no_grad()
def test_class_token_takes_part_in_attention_only() -> None:
    images, lengths_px = crops([12, 20], 20)
    blind, seeing = network(depth=0), network(depth=1)
    for vision, is_seen in ((blind, False), (seeing, True)):
        before = vision(images, lengths_px)
        vision.class_token.normal_(std=5.0)
        changed = not torch.allclose(vision(images, lengths_px), before)
        assert changed == is_seen


@torch.no_grad()
def test_tokens_are_class_token_and_patches_with_their_positions() -> None:
    vision = network()
    images, lengths_px = crops([12], 15)
    tokens, valid = vision.tokens(images, lengths_px)
    assert tokens.shape == (1, 1 + 2 * 3, 12) and valid.tolist() == [[True] * 7]
    torch.testing.assert_close(tokens[0, 0], (vision.class_token + vision.class_position)[0, 0])
    # The second row's third column is token 1 + 3 + 2.
    patch = vision.embed(images[0, 0, 4:8, 10:15].flatten())
    torch.testing.assert_close(tokens[0, 6], patch + vision.patch_positions[0, 1, 2])


def test_places_along_the_link_are_told_apart() -> None:
    """The same wall near the access point and near the device gives different features."""
    vision = network()
    near, far = torch.zeros(2, 1, 1, HEIGHT, 20)
    near[..., 1], far[..., 16] = 1.0, 1.0
    length = torch.tensor([20])
    assert not torch.allclose(vision(near, length), vision(far, length))


def test_crops_are_4_m_wide_and_as_long_as_the_position_embedding() -> None:
    crops = network().crops
    assert (crops.pixels_per_metre, crops.width_m) == (2.0, 4.0)
    assert (crops.max_length_px, crops.patch_length_px) == (40, 5)


def test_gradients_reach_every_parameter() -> None:
    vision = network().train()
    images, lengths_px = crops([3, 10, 17, 40], 40)
    vision(images, lengths_px).sum().backward()
    for name, parameter in vision.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name


def test_images_longer_than_the_position_embedding_are_refused() -> None:
    images, lengths_px = crops([45], 45)
    with pytest.raises(RuntimeError):
        network()(images, lengths_px)


@pytest.mark.parametrize("norm", ["batch", "none"])
@torch.no_grad()
def test_attention_is_what_the_last_block_attends_with(norm: str) -> None:
    vision = network(norm)
    images, lengths_px = crops([3, 17, 20], 20)
    seen: list[Tensor] = []
    hook = vision.blocks[-1].attention.attn_drop.register_forward_hook(lambda *call: seen.append(call[2]))
    vision(images, lengths_px)
    hook.remove()
    maps = seen[0].mean(dim=1)
    attention = vision.attention(images, lengths_px)
    assert attention.class_token.shape == attention.patches.shape == (3, 2, 4)
    torch.testing.assert_close(attention.class_token, maps[:, 0, 1:].reshape(3, 2, 4))
    # The crop of 17 pixels fills its 4 patch columns; the one of 3 has one, rows 0 and 4 of its patches.
    torch.testing.assert_close(attention.patches[1], maps[1, 1:, 1:].mean(dim=0).reshape(2, 4))
    torch.testing.assert_close(attention.patches[0], maps[0, [1, 5], 1:].mean(dim=0).reshape(2, 4))
    assert (attention.patches[0, :, 1:] == 0).all() and (attention.class_token[0, :, 1:] == 0).all()


@torch.no_grad()
def test_attention_of_a_crop_does_not_depend_on_its_padding() -> None:
    vision = network()
    images, lengths_px = crops([3, 10], 10)
    short = vision.attention(images, lengths_px)
    padded = vision.attention(torch.nn.functional.pad(images, (0, 20)), lengths_px)
    torch.testing.assert_close(padded.patches[..., :2], short.patches)
    torch.testing.assert_close(padded.class_token[..., :2], short.class_token)
