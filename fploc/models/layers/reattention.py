"""Re-attention (Zhou et al., DeepViT, 2021): attention maps mixed over heads before they weigh the values."""

from __future__ import annotations

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


class ReAttention(nn.Module):
    """Re-Attention(Q, K, V) = Norm(Θᵀ softmax(QKᵀ/√d)) V, as a timm-style attention layer.

    Paper: Zhou et al., "DeepViT: Towards Deeper Vision Transformer", 2021, eq. 3; Yu et al., section
    "DeepVIT block". Changed: tokens may be padding; the normalised maps of padded keys are set to 0, so
    that in evaluation the result does not depend on how far a batch is padded.

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
        norms = {"batch": nn.BatchNorm2d, "layer": LayerNorm2d, "none": nn.Identity}
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
        queries, keys, values = self.split(tokens)
        maps = self.maps(queries, keys, valid)
        attended = (self.attn_drop(maps) @ values).transpose(1, 2)
        projected: Tensor = self.proj_drop(self.proj(attended.flatten(2)))
        return projected

    def split(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return queries, keys and values of tokens (B, N, D), shape (B, H, N, d) each."""
        B, N, _ = tokens.shape
        split = self.qkv(tokens).reshape(B, N, 3, self.num_heads, self.head_dim).permute(2, 0, 3, 1, 4)
        queries, keys, values = split
        return queries, keys, values

    def maps(self, queries: Tensor, keys: Tensor, valid: Tensor) -> Tensor:
        """Return Norm(Θᵀ softmax(QKᵀ/√d)), shape (B, H, N, N)."""
        mixed = mix_heads(attention_maps(queries, keys, valid), self.theta)
        normalised: Tensor = self.norm(mixed)
        return normalised.masked_fill(~valid[:, None, None, :], 0.0)
