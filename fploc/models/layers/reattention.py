"""Re-attention (Zhou et al., DeepViT, 2021): attention maps mixed over heads before they weigh the values."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from timm.layers.norm import LayerNorm2d
from torch import Tensor, nn

from fploc.errors import UnknownNameError


def attention_maps(queries: Tensor, keys: Tensor, valid: Tensor) -> Tensor:
    """Return softmax(QKᵀ/√d) over the valid keys.

    Args:
        queries: Shape (B, H, N, d).
        keys: Shape (B, H, N, d).
        valid: True for tokens that are no padding, shape (B, N).

    Returns:
        Shape (B, H, N, N); rows sum to 1, columns of padding are 0.
    """
    scores = queries @ keys.transpose(-2, -1) * queries.shape[-1] ** -0.5
    return scores.masked_fill(~valid[:, None, None, :], -torch.inf).softmax(dim=-1)


def mix_heads(maps: Tensor, theta: Tensor) -> Tensor:
    """Return Θᵀ applied over the axis of heads.

    Args:
        maps: Shape (B, H, N, N).
        theta: Θ of shape (H, H).
    """
    return (theta.T @ maps.flatten(2)).view_as(maps)


def near_identity(heads: int, scale: float = 0.05) -> Tensor:
    """Return Θ near the identity, shape (H, H), so that training starts from plain attention."""
    return torch.eye(heads) + scale * torch.randn(heads, heads)


class BatchNormOfMaps(nn.BatchNorm2d):
    """Batch norm of maps (B, H, N, N) whose statistics are of the entries between tokens that are no padding."""

    def together(self, maps: Sequence[Tensor], valid: Sequence[Tensor]) -> list[Tensor]:
        """Return several batches of maps, of unlike N, normalised as one.

        Args:
            maps: Shape (B, H, N, N) each; columns of padding are 0.
            valid: True for tokens that are no padding, shape (B, N) each.
        """
        if not self.training:
            return [self(one) for one in maps]
        mean, variance = self._counted(maps, valid)
        scale = self.weight * (variance + self.eps).rsqrt()
        shift = self.bias - mean * scale
        return [one * scale[:, None, None] + shift[:, None, None] for one in maps]

    def _counted(self, maps: Sequence[Tensor], valid: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Return mean and variance of each head, shape (H,), and take them into the running ones."""
        wide = torch.promote_types(maps[0].dtype, torch.float32)
        counts = torch.stack([one.sum(1).square().sum() for one in valid]).sum().to(wide)
        mean = _sums(maps, valid, wide) / counts
        squares = _sums([one.square() for one in maps], valid, wide) / counts
        variance = (squares - mean.square()).clamp(min=0.0)
        with torch.no_grad():
            assert self.running_mean is not None and self.running_var is not None
            assert self.num_batches_tracked is not None and self.momentum is not None
            unbiased = variance * counts / (counts - 1).clamp(min=1.0)
            self.running_mean.lerp_(mean.to(self.running_mean.dtype), self.momentum)
            self.running_var.lerp_(unbiased.to(self.running_var.dtype), self.momentum)
            self.num_batches_tracked += 1
        return mean, variance


def _sums(maps: Sequence[Tensor], valid: Sequence[Tensor], dtype: torch.dtype) -> Tensor:
    """Return sums (H,) over all maps (B, H, N, N), of the rows (B, N) that are valid."""
    rows = [one.sum(-1, dtype=dtype) for one in maps]
    return torch.stack(
        [(one * those[:, None]).sum((0, 2)) for one, those in zip(rows, valid, strict=True)]
    ).sum(0)


class ReAttention(nn.Module):
    """Re-Attention(Q, K, V) = Norm(Θᵀ softmax(QKᵀ/√d)) V, as a timm-style attention layer.

    Paper: Zhou et al., "DeepViT: Towards Deeper Vision Transformer", 2021, eq. 3; Yu et al., section
    "DeepVIT block". Changed: tokens may be padding; the normalised maps of padded keys are set to 0, and the
    norm counts no padding, so that the result does not depend on how far a batch is padded.

    Args:
        dim: Width of the tokens, D.
        num_heads: H.
        head_dim: Width of each head, d; the published 2 heads × 64 are narrower than D = 512.
        norm: Norm over the mixed maps (B, H, N, N): ``batch`` (BatchNorm2d, as in the authors' code),
            ``layer`` (over heads, as in a popular rewrite; with 2 heads nearly a sign function) or ``none``.
        qkv_bias: Whether queries, keys and values have a bias.
        attn_drop: Dropout rate of the maps.
        proj_drop: Dropout rate after the projection.

    Raises:
        UnknownNameError: If there is no such norm.

    Shapes:
        - **input:** tokens (B, N, D), valid (B, N)
        - **output:** (B, N, D)
    """

    def __init__(
        self,
        dim: int,
        num_heads: int,
        head_dim: int,
        norm: str = "batch",
        qkv_bias: bool = False,
        attn_drop: float = 0.0,
        proj_drop: float = 0.0,
    ) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.head_dim = head_dim
        self.qkv = nn.Linear(dim, 3 * num_heads * head_dim, bias=qkv_bias)
        self.theta = nn.Parameter(near_identity(num_heads))
        norms = {"batch": BatchNormOfMaps, "layer": LayerNorm2d, "none": nn.Identity}
        if norm not in norms:
            raise UnknownNameError(
                "norm of re-attention", norm, known=list(norms), way_out="correct `attention_norm`"
            )
        self.norm = norms[norm](num_heads)
        self.attn_drop = nn.Dropout(attn_drop)
        self.proj = nn.Linear(num_heads * head_dim, dim)
        self.proj_drop = nn.Dropout(proj_drop)

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """Return the attended tokens; see the class for shapes."""
        return self.together([tokens], [valid])[0]

    def together(self, tokens: Sequence[Tensor], valid: Sequence[Tensor]) -> list[Tensor]:
        """Return the attended tokens of several batches, of unlike N, that the norm takes for one batch."""
        queries, keys, values = zip(*(self.split(one) for one in tokens), strict=True)
        maps = self.maps(queries, keys, valid)
        return [self.projected(one, those) for one, those in zip(maps, values, strict=True)]

    def split(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return queries, keys and values of tokens (B, N, D), shape (B, H, N, d) each."""
        B, N, _ = tokens.shape
        split = self.qkv(tokens).reshape(B, N, 3, self.num_heads, self.head_dim).permute(2, 0, 3, 1, 4)
        queries, keys, values = split
        return queries, keys, values

    def maps(
        self, queries: Sequence[Tensor], keys: Sequence[Tensor], valid: Sequence[Tensor]
    ) -> list[Tensor]:
        """Return Norm(Θᵀ softmax(QKᵀ/√d)) of several batches, shape (B, H, N, N) each."""
        mixed = [
            mix_heads(attention_maps(*one), self.theta) for one in zip(queries, keys, valid, strict=True)
        ]
        if isinstance(self.norm, BatchNormOfMaps):
            normalised = self.norm.together(mixed, valid)
        else:
            normalised = [self.norm(one) for one in mixed]
        return [
            one.masked_fill(~those[:, None, None, :], 0.0)
            for one, those in zip(normalised, valid, strict=True)
        ]

    def projected(self, maps: Tensor, values: Tensor) -> Tensor:
        """Return the values (B, H, N, d) weighed by maps (B, H, N, N), all heads together, shape (B, N, D)."""
        attended = (self.attn_drop(maps) @ values).transpose(1, 2)
        projected: Tensor = self.proj_drop(self.proj(attended.flatten(2)))
        return projected
