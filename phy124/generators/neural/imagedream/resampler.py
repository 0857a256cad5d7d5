"""ImageDream's resampler: condenses 257 picture tokens into 16 tokens of the context.

A perceiver (Alayrac et al. 2022, "Flamingo"), as in IP-Adapter (Ye et al. 2023).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

HEADS, HEAD_WIDTH = 12, 64


class PerceiverAttention(nn.Module):
    """Attention from latents [B,K,C] to the picture's tokens and to the latents themselves."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = HEADS * HEAD_WIDTH
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)
        self.to_q = nn.Linear(channels, inner, bias=False)
        self.to_kv = nn.Linear(channels, 2 * inner, bias=False)
        self.to_out = nn.Linear(inner, channels, bias=False)

    def forward(self, x: Tensor, latents: Tensor) -> Tensor:
        """x [B,M,C], latents [B,K,C] -> [B,K,C]."""
        x, latents = self.norm1(x), self.norm2(latents)
        k, v = self.to_kv(torch.cat([x, latents], dim=1)).chunk(2, dim=-1)
        q, k, v = (t.unflatten(-1, (HEADS, -1)).transpose(1, 2) for t in (self.to_q(latents), k, v))
        # Half of the scale on each side and softmax in float32 keep half precision in range.
        scale = HEAD_WIDTH**-0.25
        weights = ((q * scale) @ (k * scale).transpose(-2, -1)).float().softmax(dim=-1).to(v.dtype)
        return self.to_out((weights @ v).transpose(1, 2).flatten(2))


def _feed_forward(channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.LayerNorm(channels),
        nn.Linear(channels, 4 * channels, bias=False),
        nn.GELU(),
        nn.Linear(4 * channels, channels, bias=False),
    )


class Resampler(nn.Module):
    """Tokens of a picture [B,M,inputs] -> [B,K,C]."""

    def __init__(self, inputs: int, channels: int, tokens: int, depth: int = 4) -> None:
        super().__init__()
        self.latents = nn.Parameter(torch.randn(1, tokens, channels) / channels**0.5)
        self.proj_in = nn.Linear(inputs, channels)
        self.proj_out = nn.Linear(channels, channels)
        self.norm_out = nn.LayerNorm(channels)
        self.layers = nn.ModuleList(
            nn.ModuleList([PerceiverAttention(channels), _feed_forward(channels)])
            for _ in range(depth)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Start from the learnt latents and attend to the picture `depth` times."""
        latents = self.latents.expand(len(x), -1, -1)
        x = self.proj_in(x)
        for layer in self.layers:
            attention, feed_forward = layer  # pyright: ignore[reportGeneralTypeIssues]
            latents = attention(x, latents) + latents
            latents = feed_forward(latents) + latents
        return self.norm_out(self.proj_out(latents))
