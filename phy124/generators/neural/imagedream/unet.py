"""The multi-view U-Net of ImageDream; without an image condition, it equals MVDream's U-Net.

The network is a latent diffusion U-Net (Rombach et al. 2022) with self-attention over all views.
Wang & Shi 2023, "ImageDream"; Shi et al. 2023, "MVDream".
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from phy124.errors import InputError
from phy124.generators.neural.imagedream.attention import (
    GROUPS,
    Downsample,
    ResBlock,
    SpatialTransformer,
    Stage,
    Upsample,
)
from phy124.generators.neural.imagedream.encoders import Resampler
from phy124.weights.checkpoints import StateDict, fill, read_tensors, strip_prefix

CLIP_WIDTH = 1280
"""Width of CLIP's image tokens."""
ORIGINAL_PREFIX = "model.diffusion_model."
"""Prefix in the checkpoint of ImageDream's authors."""


@dataclass(frozen=True)
class Config:
    """Sizes of the network, with the names and values of ImageDream's config.json."""

    in_channels: int = 4
    out_channels: int = 4
    model_channels: int = 320
    channel_mult: Sequence[int] = (1, 2, 4, 4)
    num_res_blocks: int = 2
    attention_resolutions: Sequence[int] = (4, 2, 1)
    """Factors of downsampling with attention."""
    num_head_channels: int = 64
    transformer_depth: int = 1
    context_dim: int = 1024
    camera_dim: int = 16
    ip_dim: int = 16
    """Number of image tokens; 0 for MVDream."""
    ip_weight: float = 1.0
    image_size: int = 32
    """Side of the latents in training; this setting has no effect."""
    use_checkpoint: bool = False
    """This setting has no effect."""


class MultiViewUNet(nn.Module):
    """Predicts the noise in the latents [B*F,4,h,w] of F views of each object."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        width = config.model_channels
        embedding = 4 * width
        if config.ip_dim:
            self.image_embed = Resampler(CLIP_WIDTH, config.context_dim, config.ip_dim)
        self.time_embed = _two_layers(width, embedding)
        self.camera_embed = _two_layers(config.camera_dim, embedding)
        first = nn.Conv2d(config.in_channels, width, 3, padding=1)
        self.input_blocks = nn.ModuleList([Stage(first)])
        channels, skips = self._build_inputs(embedding)
        self.middle_block = Stage(
            ResBlock(channels, channels, embedding),
            self._transformer(channels),
            ResBlock(channels, channels, embedding),
        )
        self.output_blocks = nn.ModuleList()
        channels = self._build_outputs(channels, skips, embedding)
        last = nn.Conv2d(channels, config.out_channels, 3, padding=1)
        self.out = nn.Sequential(nn.GroupNorm(GROUPS, channels), nn.SiLU(), last)

    def _transformer(self, channels: int) -> SpatialTransformer:
        c = self.config
        return SpatialTransformer(
            channels,
            c.context_dim,
            channels // c.num_head_channels,
            depth=c.transformer_depth,
            picture_tokens=c.ip_dim,
            picture_weight=c.ip_weight,
        )

    def _layers(self, inputs: int, outputs: int, embedding: int, level: int) -> list[nn.Module]:
        layers: list[nn.Module] = [ResBlock(inputs, outputs, embedding)]
        if 2**level in self.config.attention_resolutions:
            layers.append(self._transformer(outputs))
        return layers

    def _build_inputs(self, embedding: int) -> tuple[int, list[int]]:
        """Return the number of channels of the last layer, and of each skip connection."""
        c = self.config
        channels, skips = c.model_channels, [c.model_channels]
        for level, factor in enumerate(c.channel_mult):
            for _ in range(c.num_res_blocks):
                width = factor * c.model_channels
                self.input_blocks.append(Stage(*self._layers(channels, width, embedding, level)))
                channels = width
                skips.append(channels)
            if level < len(c.channel_mult) - 1:
                self.input_blocks.append(Stage(Downsample(channels)))
                skips.append(channels)
        return channels, skips

    def _build_outputs(self, channels: int, skips: list[int], embedding: int) -> int:
        c = self.config
        for level in reversed(range(len(c.channel_mult))):
            for i in range(c.num_res_blocks + 1):
                width = c.channel_mult[level] * c.model_channels
                layers = self._layers(channels + skips.pop(), width, embedding, level)
                channels = width
                if level and i == c.num_res_blocks:
                    layers.append(Upsample(channels))
                self.output_blocks.append(Stage(*layers))
        return channels

    def forward(
        self,
        x: Tensor,
        timesteps: Tensor,
        context: Tensor,
        num_frames: int = 1,
        camera: Tensor | None = None,
        ip: Tensor | None = None,
        ip_img: Tensor | None = None,
    ) -> Tensor:
        """Predict the noise [B*F,4,h,w].

        Args:
            x: Latents [B*F,4,h,w]; the views of an object are adjacent.
            timesteps: Noise levels [B*F], 0 to 999.
            context: Text tokens [B*F,77,context_dim].
            num_frames: Number of frames F, including the image's frame.
            camera: Camera-to-world transforms [B*F,16], row by row; zeros for the image's frame.
            ip: CLIP tokens of the image [B*F,257,1280].
            ip_img: Latents of the image [B,4,h,w], which replace each object's last frame.
        """
        if ip is not None and ip_img is not None:
            x = with_picture(x, ip_img, num_frames)
            context = torch.cat([context, self.image_embed(ip)], dim=1)
        dtype = x.dtype
        embedding = self.time_embed(
            timestep_embedding(timesteps, self.config.model_channels).to(dtype)
        )
        if camera is not None:
            embedding = embedding + self.camera_embed(camera.to(dtype))
        skips = []
        for stage in self.input_blocks:
            x = stage(x, embedding, context, num_frames)
            skips.append(x)
        x = self.middle_block(x, embedding, context, num_frames)
        for stage in self.output_blocks:
            x = stage(torch.cat([x, skips.pop()], dim=1), embedding, context, num_frames)
        return self.out(x)


def with_picture(x: Tensor, ip_img: Tensor, num_frames: int) -> Tensor:
    """Return latents [B*F,4,h,w]; the last frame of each object contains the image's latents."""
    x = x.clone()
    x[num_frames - 1 :: num_frames] = ip_img.to(x.dtype)
    return x


def timestep_embedding(timesteps: Tensor, width: int) -> Tensor:
    """Return the sinusoidal embedding [N,width] of `timesteps [N]`: cosines, then sines."""
    half = width // 2
    steps = torch.arange(half, dtype=torch.float32, device=timesteps.device)
    angles = timesteps[:, None].float() * torch.exp(-math.log(10000) * steps / half)
    return torch.cat([torch.cos(angles), torch.sin(angles)], dim=-1)


def _two_layers(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, outputs), nn.SiLU(), nn.Linear(outputs, outputs))


def load_unet(
    state_dict_or_path: StateDict | str | os.PathLike[str],
    *,
    device: str | torch.device = "cpu",
    dtype: torch.dtype = torch.float32,
    **config: Any,
) -> MultiViewUNet:
    """Build the network and load the weights.

    Tensors may be named as in diffusers or as in the authors' checkpoint. Without tensors for an
    image condition, the network is MVDream's.

    Args:
        state_dict_or_path: Tensors by name, or a file of tensors.
        device: Device of the network.
        dtype: Precision of the network.
        **config: Fields of `Config` that differ from the defaults.

    Raises:
        InputError: If a field is unknown or the tensors do not fit this network.
    """
    tensors = state_dict_or_path
    if isinstance(tensors, (str, os.PathLike)):
        tensors = read_tensors(tensors)
    tensors = strip_prefix(tensors, ORIGINAL_PREFIX)
    if not any(key.startswith("image_embed.") for key in tensors):
        config.setdefault("ip_dim", 0)
    try:
        chosen = Config(**config)
    except TypeError as error:
        known = ", ".join(Config.__dataclass_fields__)
        raise InputError(
            "config",
            ", ".join(config),
            f"it has an unknown field; the fields are {known}.",
            "Leave it out.",
        ) from error
    with torch.device("meta"):
        unet = MultiViewUNet(chosen)
    fill(unet, tensors, "ImageDream's U-Net" if chosen.ip_dim else "MVDream's U-Net")
    return unet.to(device=device, dtype=dtype).eval().requires_grad_(False)
