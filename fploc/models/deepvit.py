"""DeepViT on crops of the floor plan: patches, class token, re-attention encoder, mean, head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import torch
from timm.layers.drop import DropPath
from timm.layers.mlp import Mlp
from timm.layers.weight_init import trunc_normal_
from torch import Tensor, nn

from fploc.errors import FplocError
from fploc.floorplan.raster import CropSettings
from fploc.models.layers.reattention import ReAttention

CROP_WIDTH_M = 4.0
"""Extent of a crop across the link, H of the paper: 256 pixels at 64 px/m."""

CROPS_AT_ONCE = 128
"""Of like length."""


def valid_columns(lengths_px: Tensor, patch_length_px: int, columns: int) -> Tensor:
    """Return which patch columns hold any of the crop.

    Args:
        lengths_px: Valid pixel columns of each crop, shape (B,).
        patch_length_px: Length of a patch along the link, pixels.
        columns: Patch columns of the padded crop.

    Returns:
        True where a patch column starts inside the crop, shape (B, columns); the first always does.
    """
    starts = torch.arange(columns, device=lengths_px.device) * patch_length_px
    return starts < lengths_px[:, None].clamp(min=1)


def split_and_flatten(images: Tensor, patch_px: tuple[int, int]) -> Tensor:
    """Return the flattened patches s_ℓ of images (B, 1, H, W), shape (B, rows, columns, pixels of a patch)."""
    B, _, H, W = images.shape
    height, length = patch_px
    patches = images.reshape(B, H // height, height, W // length, length)
    return patches.permute(0, 1, 3, 2, 4).flatten(3)


class EncoderBlock(nn.Module):
    """Norm, re-attention, norm, FFNN of two layers, with two residual connections (Zhou et al. 2021, fig. 4).

    Table II of Yu et al. lists otherwise what their text calls "the same structure as" Zhou's: a ReLU behind the
    projection of re-attention, one layer with GELU as FFNN, residual connections nowhere. Followed is the text,
    since a ReLU before a residual sum could only ever add.
    """

    def __init__(
        self,
        dim: int,
        num_heads: int,
        head_dim: int,
        mlp_ratio: float,
        attention_norm: str,
        drop: float,
        drop_path: float,
    ) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(dim)
        self.attention = ReAttention(dim, num_heads, head_dim, norm=attention_norm, proj_drop=drop)
        self.norm2 = nn.LayerNorm(dim)
        self.mlp = Mlp(dim, hidden_features=int(dim * mlp_ratio), drop=drop)
        self.drop_path = DropPath(drop_path)

    def forward(self, tokens: Sequence[Tensor], valid: Sequence[Tensor]) -> list[Tensor]:
        """Return batches of tokens (B, N, D) after attention over ``valid`` (B, N) and the FFNN.

        Batches may differ in N; the norm of re-attention takes them for one.
        """
        attended = self.attention.together([self.norm1(one) for one in tokens], valid)
        return [self._fed(one + self.drop_path(those)) for one, those in zip(tokens, attended, strict=True)]

    def maps(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Return the normalised maps (B, H, N, N) that the tokens (B, N, D) are attended with."""
        queries, keys, _ = self.attention.split(self.norm1(tokens))
        return self.attention.maps([queries], [keys], [valid])[0]

    def _fed(self, tokens: Tensor) -> Tensor:
        """Return the tokens (B, N, D) after the FFNN."""
        encoded: Tensor = tokens + self.drop_path(self.mlp(self.norm2(tokens)))
        return encoded


@dataclass(frozen=True)
class CropAttention:
    """Normalised maps Norm(Θᵀ softmax(QKᵀ/√d)) of the last encoder block, mean over heads, on the patches.

    The norm may make them negative, and they need not sum to 1. Padding is 0.

    Args:
        class_token: What the class token attends to, shape (B, rows, columns).
        patches: What the valid patches attend to on average, shape (B, rows, columns). The features are made
            from the patches' tokens: of the last block's maps, only these rows reach the output.
    """

    class_token: Tensor
    patches: Tensor


class DeepViT(nn.Module):
    """Features of a crop between an access point and a device.

    Paper: Yu et al., section "DeepVIT block" and Table II; Zhou et al. 2021. A patch spans ``patch_px``
    pixels; each is embedded linearly (eq. "split_flatten"), the class token is prepended and a learned
    position embedding added (eq. "split_flatten_2"). Crops are padded at the device's end.

    What the paper leaves open: the class token is prepended and gone behind re-attention (Table II: N_s + 1
    tokens in, N_s out), so it takes part in the attention, and the mean is over the valid patches without it.
    E_pos has as many rows as a link has patches, so it is learned for the longest crop, one row for each place
    in the grid of patches; a shorter crop takes those of its places.

    Args:
        crop_height_px: Height of a crop, H.
        max_length_px: Longest crop, the stated maximum of the position embedding.
        patch_px: Height and length of a patch; they divide ``crop_height_px`` and ``max_length_px``.
        dim: Width of the tokens, D.
        depth: Encoder blocks.
        num_heads: Attention heads.
        head_dim: Width of a head.
        mlp_ratio: Hidden width of the FFNN over D.
        features: Width of the output.
        attention_norm: Norm of re-attention; see ``ReAttention``.
        drop: Dropout rate behind re-attention and each layer of the FFNN (Table II: behind FC2 alone).
        drop_path: Stochastic depth rate.

    Raises:
        FplocError: If the patches do not divide the crop.

    Shapes:
        - **input:** images (B, 1, H, W) with 1 = drawn and W ≤ ``max_length_px`` a multiple of the patch
          length; lengths_px (B,)
        - **output:** (B, ``features``)
    """

    def __init__(
        self,
        crop_height_px: int,
        max_length_px: int,
        patch_px: tuple[int, int],
        dim: int,
        depth: int,
        num_heads: int,
        head_dim: int,
        mlp_ratio: float = 1.0,
        features: int = 32,
        attention_norm: str = "batch",
        drop: float = 0.2,
        drop_path: float = 0.0,
    ) -> None:
        super().__init__()
        self.crop_height_px = crop_height_px
        self.max_length_px = max_length_px
        self.patch_px = patch_px
        self.features = features
        self.rows = crop_height_px // patch_px[0]
        self.columns = max_length_px // patch_px[1]
        if (self.rows * patch_px[0], self.columns * patch_px[1]) != (crop_height_px, max_length_px):
            raise FplocError(
                "patch_px of DeepViT",
                value=f"{patch_px[0]} × {patch_px[1]}",
                expected=f"divisors of crop_height_px {crop_height_px} and max_length_px {max_length_px}",
                way_out="change `patch_px` or the size of the crop",
            )
        self.embed = nn.Linear(patch_px[0] * patch_px[1], dim)
        self.class_token = nn.Parameter(torch.zeros(1, 1, dim))
        self.class_position = nn.Parameter(torch.zeros(1, 1, dim))
        self.patch_positions = nn.Parameter(torch.zeros(1, self.rows, self.columns, dim))
        self.blocks = nn.ModuleList(
            EncoderBlock(dim, num_heads, head_dim, mlp_ratio, attention_norm, drop, drop_path)
            for _ in range(depth)
        )
        self.head = nn.Sequential(nn.LayerNorm(dim), nn.Linear(dim, features), nn.ReLU())
        for parameter in (self.class_token, self.class_position, self.patch_positions):
            trunc_normal_(parameter, std=0.02)

    @property
    def crops(self) -> CropSettings:
        """How crops for this network are taken."""
        return CropSettings(
            pixels_per_metre=self.crop_height_px / CROP_WIDTH_M,
            width_m=CROP_WIDTH_M,
            max_length_px=self.max_length_px,
            patch_length_px=self.patch_px[1],
        )

    def forward(self, images: Tensor, lengths_px: Tensor) -> Tensor:
        """Return the features of crops; see the class for shapes.

        Padding changes nothing: crops of like length go together, and short ones are spared that to the longest.
        """
        if len(images) <= 1:
            return self.encoded([images], [lengths_px])[0]
        order = lengths_px.argsort()
        chunks = order.split(CROPS_AT_ONCE)
        longest_px = lengths_px[torch.stack([chunk[-1] for chunk in chunks])].tolist()
        cut = [images[one, :, :, : self.padded_px(px)] for one, px in zip(chunks, longest_px, strict=True)]
        features = self.encoded(cut, [lengths_px[one] for one in chunks])
        return torch.cat(features)[order.argsort()]

    def padded_px(self, length_px: int) -> int:
        """Return the whole patches, in pixels, that hold a crop of ``length_px``; at least one."""
        patch_px = self.patch_px[1]
        return max(1, ceil(length_px / patch_px)) * patch_px

    def encoded(self, images: Sequence[Tensor], lengths_px: Sequence[Tensor]) -> list[Tensor]:
        """Return the features of several batches of crops, each padded alike; arguments as ``forward``."""
        tokens, valid = zip(*map(self.tokens, images, lengths_px), strict=True)
        for block in self.blocks:
            tokens = block(tokens, valid)
        return [self.head(self.mean_over_patches(*one)) for one in zip(tokens, valid, strict=True)]

    def attention(self, images: Tensor, lengths_px: Tensor) -> CropAttention:
        """Return where the last encoder block looks; arguments as ``forward``."""
        tokens, valid = self.tokens(images, lengths_px)
        *earlier, last = self.blocks
        for block in earlier:
            (tokens,) = block([tokens], [valid])
        assert isinstance(last, EncoderBlock)
        maps = last.maps(tokens, valid).mean(dim=1)
        on_grid = maps[:, :, 1:].unflatten(2, (self.rows, -1))
        return CropAttention(
            class_token=on_grid[:, 0],
            patches=self.mean_over_patches(on_grid.flatten(2), valid).unflatten(1, on_grid.shape[2:]),
        )

    def tokens(self, images: Tensor, lengths_px: Tensor) -> tuple[Tensor, Tensor]:
        """Return class token and patches with their positions (B, N, D), and which are valid (B, N)."""
        patches = self.embed(split_and_flatten(images, self.patch_px))
        B, rows, columns, _ = patches.shape
        patches = (patches + self.patch_positions[:, :, :columns]).flatten(1, 2)
        first = (self.class_token + self.class_position).expand(B, -1, -1)
        valid = valid_columns(lengths_px, self.patch_px[1], columns)[:, None, :].expand(B, rows, columns)
        valid = torch.cat([valid.new_ones(B, 1), valid.flatten(1)], dim=1)
        return torch.cat([first, patches], dim=1), valid

    @staticmethod
    def mean_over_patches(tokens: Tensor, valid: Tensor) -> Tensor:
        """Return the mean of the valid patches, without the class token, shape (B, D)."""
        weights = valid[:, 1:, None].to(tokens.dtype)
        return (tokens[:, 1:] * weights).sum(1) / weights.sum(1)
