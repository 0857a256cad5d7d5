"""Guidance by ImageDream: score distillation for four views at a time, 90 degrees apart.

Wang & Shi 2023, "ImageDream". The noise difference has weight 1, and the loss is divided by the
number of views, as in DreamGaussian's program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from phy124.generators.neural.dreamgaussian.guidance import Pose, add_noise, sds, timestep
from phy124.generators.neural.imagedream.pipeline import (
    SIZE,
    Condition,
    Parts,
    look,
    pose_row,
    predict_guided,
)


class MultiView:
    """Score distillation with the networks of the ImageDream generator."""

    views = 4

    def __init__(self, unet: Any, vae: Any, condition: Condition, *, guidance: float = 5.0) -> None:
        self.unet, self.vae, self.condition = unet, vae, condition
        self.guidance = guidance

    @classmethod
    @torch.no_grad()
    def looking_at(cls, image: Tensor, parts: Parts, *, seed: int = 0) -> MultiView:
        """Create the guidance for an image."""
        condition = look(parts, image, torch.Generator().manual_seed(seed))
        return cls(parts.unet, parts.vae, condition)

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Return the SDS loss of four views; see `Guidance`."""
        level = timestep(ratio)
        latents = self._latents(images, draw)
        noise = torch.randn(latents.shape, generator=draw).to(latents)
        with torch.no_grad():
            predicted = self._noise(add_noise(latents, noise, level), level, poses)
        return sds(latents, predicted, noise, 1.0) / self.views

    def _latents(self, images: Tensor, draw: torch.Generator) -> Tensor:
        square = interpolate(images, (SIZE, SIZE), mode="bilinear", align_corners=False)
        posterior = self.vae.encode(2 * square.to(self.condition.latents) - 1).latent_dist
        noise = torch.randn(posterior.mean.shape, generator=draw).to(posterior.mean)
        return (posterior.mean + posterior.std * noise) * self.vae.config.scaling_factor

    def _noise(self, latents: Tensor, level: int, poses: Sequence[Pose]) -> Tensor:
        rows = [pose_row(pose.elevation, pose.azimuth) for pose in poses]
        cameras = torch.tensor([*rows, [0.0] * 16]).to(self.condition.cameras)
        condition = replace(self.condition, cameras=cameras)
        # The U-Net replaces the fifth frame by the image; the noise predicted for it is not used.
        frames = torch.cat([latents, self.condition.latents])
        return predict_guided(self.unet, frames, torch.tensor(level), condition, self.guidance)[
            : self.views
        ]
