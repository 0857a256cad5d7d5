"""The asymmetric U-Net of LGM: maps four views to 14 numbers per pixel of each view.

Tang et al. 2024, "LGM: Large Multi-View Gaussian Model for High-Resolution 3D Content Creation",
section 3.3. Submodules have the same names as in the public checkpoints.
"""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

VIEWS = 4
HEADS = 16
GROUPS = 32
HALF_POWER = math.sqrt(0.5)
"""Factor that preserves the variance of the sum of a branch and its shortcut."""


class ResnetBlock(nn.Module):
    """Two 3x3 convolutions and a shortcut; maps [B*V,in,H,W] to [B*V,out,H,W]."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1 = nn.GroupNorm(GROUPS, inputs)
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2 = nn.GroupNorm(GROUPS, outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.shortcut = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return the sum of branch and shortcut, scaled to unit variance."""
        h = self.conv1(F.silu(self.norm1(x)))
        h = self.conv2(F.silu(self.norm2(h)))
        return (h + self.shortcut(x)) * HALF_POWER


class Attention(nn.Module):
    """Multi-head self-attention over a sequence [B,L,C]."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(channels, 3 * channels, bias=False)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B,L,C] to the same shape."""
        b, length, channels = x.shape
        qkv = self.qkv(x).reshape(b, length, 3, HEADS, channels // HEADS)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        heads = F.scaled_dot_product_attention(q, k, v)
        return self.proj(heads.transpose(1, 2).reshape(b, length, channels))


class CrossViewAttention(nn.Module):
    """Attention over all pixels of an object's four views."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, channels)
        self.attn = Attention(channels)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B*4,C,H,W] to the same shape."""
        bv, c, h, w = x.shape
        tokens = self.norm(x).reshape(bv // VIEWS, VIEWS, c, h * w)
        tokens = self.attn(tokens.transpose(2, 3).reshape(bv // VIEWS, VIEWS * h * w, c))
        out = tokens.reshape(bv // VIEWS, VIEWS, h * w, c).transpose(2, 3).reshape(x.shape)
        return (out + x) * HALF_POWER


def _attentions(channels: int, count: int, wanted: bool) -> nn.ModuleList:
    return nn.ModuleList(CrossViewAttention(channels) for _ in range(count if wanted else 0))


class DownBlock(nn.Module):
    """Two residual blocks, then a convolution that halves the resolution."""

    def __init__(self, inputs: int, outputs: int, *, attention: bool, downsample: bool) -> None:
        super().__init__()
        self.nets = nn.ModuleList([ResnetBlock(inputs, outputs), ResnetBlock(outputs, outputs)])
        self.attns = _attentions(outputs, 2, attention)
        self.downsample = nn.Conv2d(outputs, outputs, 3, 2, 1) if downsample else None

    def forward(self, x: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Return the output, and all maps for the skip connections."""
        skips = []
        for i, net in enumerate(self.nets):
            x = net(x)
            if self.attns:
                x = self.attns[i](x)
            skips.append(x)
        if self.downsample is not None:
            x = self.downsample(x)
            skips.append(x)
        return x, skips


class MidBlock(nn.Module):
    """A residual block, attention, and a residual block."""

    def __init__(self, channels: int, *, attention: bool) -> None:
        super().__init__()
        self.nets = nn.ModuleList([ResnetBlock(channels, channels) for _ in range(2)])
        self.attns = _attentions(channels, 1, attention)

    def forward(self, x: Tensor) -> Tensor:
        """Map [B*4,C,h,w] to the same shape."""
        x = self.nets[0](x)
        for attention in self.attns:
            x = attention(x)
        return self.nets[1](x)


class UpBlock(nn.Module):
    """Three residual blocks with one skip connection each; then the resolution is doubled."""

    def __init__(
        self, inputs: Sequence[int], outputs: int, *, attention: bool, upsample: bool
    ) -> None:
        super().__init__()
        self.nets = nn.ModuleList(ResnetBlock(n, outputs) for n in inputs)
        self.attns = _attentions(outputs, len(inputs), attention)
        self.upsample = nn.Conv2d(outputs, outputs, 3, padding=1) if upsample else None

    def forward(self, x: Tensor, skips: list[Tensor]) -> Tensor:
        """Remove the used skip tensors from the end of `skips`."""
        for i, net in enumerate(self.nets):
            x = net(torch.cat([x, skips.pop()], dim=1))
            if self.attns:
                x = self.attns[i](x)
        if self.upsample is not None:
            x = self.upsample(F.interpolate(x, scale_factor=2.0, mode="nearest"))
        return x


class UNet(nn.Module):
    """Maps [B*4,9,H,W] (colour, Pluecker ray) to [B*4,14,h,w], with h = H * 2^(ups - downs)."""

    def __init__(
        self,
        down_channels: Sequence[int],
        down_attention: Sequence[bool],
        up_channels: Sequence[int],
        up_attention: Sequence[bool],
        *,
        mid_attention: bool = True,
        inputs: int = 9,
        outputs: int = 14,
    ) -> None:
        super().__init__()
        self.conv_in = nn.Conv2d(inputs, down_channels[0], 3, padding=1)
        channels, skips = down_channels[0], [down_channels[0]]
        self.down_blocks = nn.ModuleList()
        for i, (width, attention) in enumerate(zip(down_channels, down_attention, strict=True)):
            last = i == len(down_channels) - 1
            block = DownBlock(channels, width, attention=attention, downsample=not last)
            self.down_blocks.append(block)
            channels, skips = width, skips + [width] * (2 if last else 3)
        self.mid_block = MidBlock(channels, attention=mid_attention)
        self.up_blocks = nn.ModuleList()
        for i, (width, attention) in enumerate(zip(up_channels, up_attention, strict=True)):
            joined = [before + skips.pop() for before in (channels, width, width)]
            last = i == len(up_channels) - 1
            self.up_blocks.append(UpBlock(joined, width, attention=attention, upsample=not last))
            channels = width
        self.norm_out = nn.GroupNorm(GROUPS, channels)
        self.conv_out = nn.Conv2d(channels, outputs, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Map views to output maps; the views of an object are adjacent in the batch."""
        x = self.conv_in(x)
        skips = [x]
        for block in self.down_blocks:
            x, more = block(x)
            skips += more
        x = self.mid_block(x)
        for block in self.up_blocks:
            x = block(x, skips)
        return self.conv_out(F.silu(self.norm_out(x)))
