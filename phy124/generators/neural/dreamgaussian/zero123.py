"""Guidance by Zero123: a diffusion model that predicts the view from a relative camera pose.

Liu et al. 2023, "Zero-1-to-3". The weight files have the layout of diffusers.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from diffusers.models.unets.unet_2d_condition import UNet2DConditionModel
from torch import Tensor, nn
from torch.nn.functional import interpolate
from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection

from phy124.generators.neural.dreamgaussian.guidance import (
    Pose,
    add_noise,
    alphas_cumprod,
    sds,
    timestep,
)
from phy124.generators.neural.imagedream import encoders
from phy124.weights.store import require

SIZE = 256
GUIDANCE = 5.0
"""Scale of the classifier-free guidance."""
UNET: dict[str, Any] = {"in_channels": 8, "out_channels": 4, "cross_attention_dim": 768}
VISION: dict[str, Any] = {
    "hidden_size": 1024,
    "intermediate_size": 4096,
    "num_hidden_layers": 24,
    "num_attention_heads": 16,
    "hidden_act": "quick_gelu",
    "image_size": 224,
    "patch_size": 14,
    "projection_dim": 768,
}


class CameraProjection(nn.Module):
    """Maps image embedding and pose [B,1,772] to the U-Net's context [B,1,768]."""

    def __init__(self) -> None:
        super().__init__()
        self.proj = nn.Linear(772, 768)

    def forward(self, x: Tensor) -> Tensor:
        """Return the context."""
        return self.proj(x)


def pose_embedding(poses: Sequence[Pose]) -> Tensor:
    """Return relative poses [B,1,4]: elevation, sine and cosine of the azimuth, radius."""
    rows = [
        (
            math.radians(pose.elevation),
            math.sin(math.radians(pose.azimuth)),
            math.cos(math.radians(pose.azimuth)),
            pose.radius,
        )
        for pose in poses
    ]
    return torch.tensor(rows)[:, None, :]


class Zero123:
    """Score distillation by Zero123 for a single input image."""

    def __init__(self, image: Tensor, networks: dict[str, Any]) -> None:
        """Encode the input image [3,H,W] over white, 0..1, with networks from `load_trained`."""
        self.unet, self.vae = networks["unet"], networks["vae"]
        self.projection = networks["projection"]
        self.place = next(self.projection.parameters())
        with torch.no_grad():
            pixels = encoders.clip_pixels(image)[None].to(self.place)
            self.embedding = networks["vision"](pixels).image_embeds[:, None]
            # These latents are not scaled, unlike the latents that are denoised.
            self.latents = self._latents(image[None], torch.Generator().manual_seed(0))
            self.latents = self.latents / self.vae.config.scaling_factor

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Return the SDS loss with weight 1 - alpha_t."""
        level = timestep(ratio)
        latents = self._latents(images, draw)
        noise = torch.randn(latents.shape, generator=draw).to(latents)
        with torch.no_grad():
            predicted = self._noise(add_noise(latents, noise, level), level, poses)
        return sds(latents, predicted, noise, 1 - float(alphas_cumprod()[level]))

    def _latents(self, images: Tensor, draw: torch.Generator) -> Tensor:
        square = interpolate(images, (SIZE, SIZE), mode="bilinear", align_corners=False)
        posterior = self.vae.encode(2 * square.to(self.place) - 1).latent_dist
        noise = torch.randn(posterior.mean.shape, generator=draw).to(posterior.mean)
        return (posterior.mean + posterior.std * noise) * self.vae.config.scaling_factor

    def _noise(self, latents: Tensor, level: int, poses: Sequence[Pose]) -> Tensor:
        count = len(latents)
        pose = pose_embedding(poses).to(self.place)
        context = self.projection(torch.cat([self.embedding.expand(count, -1, -1), pose], dim=-1))
        seen = self.latents.expand(count, -1, -1, -1)
        joined = torch.cat([latents, seen], dim=1)
        blind = torch.cat([latents, torch.zeros_like(seen)], dim=1)
        both = self.unet(
            torch.cat([joined, blind]),
            torch.full((2 * count,), level, device=latents.device),
            encoder_hidden_states=torch.cat([context, torch.zeros_like(context)]),
        ).sample
        with_it, without = both.chunk(2)
        return without + GUIDANCE * (with_it - without)


def unet(path: Path | None = None, **changes: Any) -> UNet2DConditionModel:
    """Build Zero123's U-Net, with the weights of `path` if there is one."""
    config = {**UNET, **changes}
    return encoders.build_filled(
        lambda: UNet2DConditionModel(**config), path, "", "Zero123's U-Net"
    )


def vision(path: Path | None = None, **changes: Any) -> CLIPVisionModelWithProjection:
    """Build CLIP ViT-L/14 with projection, with the weights of `path` if there is one."""
    config = CLIPVisionConfig(**{**VISION, **changes})
    return encoders.build_filled(
        lambda: CLIPVisionModelWithProjection(config), path, "", "Zero123's picture encoder"
    )


def load_trained(
    weights: str | os.PathLike[str] | None, device: str, dtype: torch.dtype
) -> dict[str, Any]:
    """Load the public networks for `Zero123`.

    Raises:
        InputError: If a file is missing.
    """
    files = {name.split("/")[0]: path for name, path in require("zero123", weights).items()}
    networks = {
        "unet": unet(files["unet"]),
        "vae": encoders.vae(files["vae"]),
        "vision": vision(files["image_encoder"]),
        "projection": encoders.build_filled(
            CameraProjection, files["clip_camera_projection"], "", "Zero123's camera projection"
        ),
    }
    # diffusers' method `to` would warn about mixed precision, which does not occur here.
    return {k: nn.Module.to(n, device=device, dtype=dtype) for k, n in networks.items()}
