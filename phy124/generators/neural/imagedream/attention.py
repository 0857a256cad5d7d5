"""Attention layers of the multi-view U-Net: self-attention over all frames, and cross-attention to
text and image.

Shi et al. 2023, "MVDream", section 3.1; Wang & Shi 2023, "ImageDream", section 3.2. Submodules have
the same names as in the public checkpoints.
"""

import torch.nn.functional as F
from torch import Tensor, nn

GROUPS = 32


class CrossAttention(nn.Module):
    """Multi-head attention from x [B,L,C] to a context [B,M,D], or to x.

    The last `picture_tokens` tokens of the context come from the image and have separate keys and
    values. The attention to these tokens is multiplied by `picture_weight`.
    """

    def __init__(
        self,
        channels: int,
        context: int,
        heads: int,
        *,
        picture_tokens: int = 0,
        picture_weight: float = 1.0,
    ) -> None:
        super().__init__()
        self.heads = heads
        self.picture_tokens, self.picture_weight = picture_tokens, picture_weight
        if picture_tokens:
            self.to_k_ip = nn.Linear(context, channels, bias=False)
            self.to_v_ip = nn.Linear(context, channels, bias=False)
        self.to_q = nn.Linear(channels, channels, bias=False)
        self.to_k = nn.Linear(context, channels, bias=False)
        self.to_v = nn.Linear(context, channels, bias=False)
        self.to_out = nn.Sequential(nn.Linear(channels, channels), nn.Dropout(0.0))

    def forward(self, x: Tensor, context: Tensor | None = None) -> Tensor:
        """Return [B,L,C]."""
        context = x if context is None else context
        q = self.to_q(x)
        if not self.picture_tokens:
            return self.to_out(self._attend(q, self.to_k(context), self.to_v(context)))
        text, picture = context[:, : -self.picture_tokens], context[:, -self.picture_tokens :]
        out = self._attend(q, self.to_k(text), self.to_v(text))
        seen = self._attend(q, self.to_k_ip(picture), self.to_v_ip(picture))
        return self.to_out(out + self.picture_weight * seen)

    def _attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        q, k, v = (t.unflatten(-1, (self.heads, -1)).transpose(1, 2) for t in (q, k, v))
        return F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)


class Geglu(nn.Module):
    """Linear layer with GEGLU activation: one half of the outputs gates the other half."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.proj = nn.Linear(inputs, 2 * outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map features [..., inputs] to [..., outputs]."""
        value, gate = self.proj(x).chunk(2, dim=-1)
        return value * F.gelu(gate)


class FeedForward(nn.Module):
    """Feed-forward network with a gated hidden layer of four times the width."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        wide = 4 * channels
        self.net = nn.Sequential(Geglu(channels, wide), nn.Dropout(0.0), nn.Linear(wide, channels))

    def forward(self, x: Tensor) -> Tensor:
        """Map features [..., C] to the same shape."""
        return self.net(x)


class TransformerBlock(nn.Module):
    """Attention over all frames, attention from each frame to the context, then feed-forward."""

    def __init__(
        self, channels: int, context: int, heads: int, picture_tokens: int, picture_weight: float
    ) -> None:
        super().__init__()
        self.attn1 = CrossAttention(channels, channels, heads)
        self.ff = FeedForward(channels)
        self.attn2 = CrossAttention(
            channels, context, heads, picture_tokens=picture_tokens, picture_weight=picture_weight
        )
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)
        self.norm3 = nn.LayerNorm(channels)

    def forward(self, x: Tensor, context: Tensor, num_frames: int) -> Tensor:
        """Map x [B*F,L,C] to the same shape; the frames of an object are adjacent."""
        bf, length, channels = x.shape
        joined = self.norm1(x).reshape(bf // num_frames, num_frames * length, channels)
        x = self.attn1(joined).reshape(bf, length, channels) + x
        x = self.attn2(self.norm2(x), context) + x
        return self.ff(self.norm3(x)) + x


class SpatialTransformer(nn.Module):
    """Transformer over the pixels of all frames."""

    def __init__(
        self,
        channels: int,
        context: int,
        heads: int,
        *,
        depth: int,
        picture_tokens: int,
        picture_weight: float,
    ) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, channels, eps=1e-6)
        self.proj_in = nn.Linear(channels, channels)
        self.transformer_blocks = nn.ModuleList(
            TransformerBlock(channels, context, heads, picture_tokens, picture_weight)
            for _ in range(depth)
        )
        self.proj_out = nn.Linear(channels, channels)

    def forward(self, x: Tensor, context: Tensor, num_frames: int) -> Tensor:
        """Map x [B*F,C,H,W] to the same shape; `context` is [B*F,M,D]."""
        tokens = self.proj_in(self.norm(x).flatten(2).transpose(1, 2))
        for block in self.transformer_blocks:
            tokens = block(tokens, context, num_frames)
        return self.proj_out(tokens).transpose(1, 2).reshape(x.shape) + x


class ResBlock(nn.Module):
    """Two convolutions; the embedding [B*F,E] of time and camera is added between them."""

    def __init__(self, inputs: int, outputs: int, embedding: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(
            nn.GroupNorm(GROUPS, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, padding=1)
        )
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding, outputs))
        self.out_layers = nn.Sequential(
            nn.GroupNorm(GROUPS, outputs),
            nn.SiLU(),
            nn.Dropout(0.0),
            nn.Conv2d(outputs, outputs, 3, padding=1),
        )
        same = inputs == outputs
        self.skip_connection = nn.Identity() if same else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        """Map feature maps [B*F,inputs,H,W] to [B*F,outputs,H,W]."""
        h = self.in_layers(x) + self.emb_layers(embedding)[:, :, None, None]
        return self.out_layers(h) + self.skip_connection(x)


class Downsample(nn.Module):
    """Halves the resolution of feature maps."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B*F,C,H,W] to [B*F,C,H/2,W/2]."""
        return self.op(x)


class Upsample(nn.Module):
    """Doubles the resolution of feature maps."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B*F,C,H,W] to [B*F,C,2H,2W]."""
        return self.conv(F.interpolate(x, scale_factor=2.0, mode="nearest"))


class Stage(nn.ModuleList):
    """A sequence of layers."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(layers)

    def forward(self, x: Tensor, embedding: Tensor, context: Tensor, num_frames: int) -> Tensor:
        """Apply all layers in turn; return feature maps [B*F,C',H',W'].

        Args:
            x: Feature maps [B*F,C,H,W].
            embedding: Embedding of time and camera [B*F,E].
            context: Tokens of text and image [B*F,M,D].
            num_frames: Number of frames F.
        """
        for layer in self:
            if isinstance(layer, ResBlock):
                x = layer(x, embedding)
            elif isinstance(layer, SpatialTransformer):
                x = layer(x, context, num_frames)
            else:
                x = layer(x)
        return x
