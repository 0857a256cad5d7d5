"""Convolutional blocks of the multi-view U-Net, named as in Stable Diffusion's checkpoints."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from phy124.generators.neural.imagedream.attention import GROUPS, SpatialTransformer


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
        """[B*F,inputs,H,W] -> [B*F,outputs,H,W]."""
        h = self.in_layers(x) + self.emb_layers(embedding)[:, :, None, None]
        return self.out_layers(h) + self.skip_connection(x)


class Downsample(nn.Module):
    """Half the resolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """[B*F,C,H,W] -> [B*F,C,H/2,W/2]."""
        return self.op(x)


class Upsample(nn.Module):
    """Twice the resolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """[B*F,C,H,W] -> [B*F,C,2H,2W]."""
        return self.conv(F.interpolate(x, scale_factor=2.0, mode="nearest"))


class Stage(nn.ModuleList):
    """Layers in sequence, each given what it needs of embedding, context and frame count."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(layers)

    def forward(self, x: Tensor, embedding: Tensor, context: Tensor, num_frames: int) -> Tensor:
        """[B*F,C,H,W] -> [B*F,C',H',W'].

        Args:
            x: Feature maps [B*F,C,H,W].
            embedding: Time and camera [B*F,E].
            context: Tokens of text and picture [B*F,M,D].
            num_frames: F.
        """
        for layer in self:
            if isinstance(layer, ResBlock):
                x = layer(x, embedding)
            elif isinstance(layer, SpatialTransformer):
                x = layer(x, context, num_frames)
            else:
                x = layer(x)
        return x
