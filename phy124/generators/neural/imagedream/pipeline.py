"""ImageDream's sampling: one picture to four views of its object.

Wang & Shi 2023, "ImageDream"; classifier-free guidance (Ho & Salimans 2022). A fifth frame carries
the picture itself; it is denoised as well, and LGM drops it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from phy124.generators.neural.imagedream import encoders
from phy124.generators.neural.imagedream.cameras import cameras
from phy124.generators.neural.imagedream.sampling import scheduler_of
from phy124.generators.neural.imagedream.unet import load_unet
from phy124.generators.neural.imagedream.work import PARAMETERS, STEPS
from phy124.generators.neural.precision import is_short
from phy124.generators.options import Sampler
from phy124.progress import Progress, silent
from phy124.weights.store import require

BESIDE = 2.0
"""Room that must be left for the picture's encoder to be kept, in U-Nets."""
FRAMES = 5
"""Number of frames: four views and the picture."""
SIZE = 256
"""Side of each view, pixels; latents are an eighth of it."""


@dataclass(frozen=True)
class Condition:
    """What the noise prediction depends on, without and with the picture."""

    text: Tensor
    """Text tokens [2,77,D]: negative prompt, prompt."""
    tokens: Tensor
    """Picture tokens [1,257,1280]; without the picture they are zeros."""
    latents: Tensor
    """Picture latents [1,4,h,w]; without the picture they are zeros."""
    cameras: Tensor
    """Poses [5,16]."""

    def to(self, dtype: torch.dtype) -> Condition:
        """The same in a network's precision."""
        return Condition(*(given.to(dtype) for given in vars(self).values()))


class Parts(Protocol):
    """The networks; `TrainedParts` reads them from weight files."""

    unet: Any
    vae: Any

    def text(self) -> Tensor:
        """Text tokens [1,77,D] of the empty prompt."""
        ...

    def picture(self, image: Tensor) -> Tensor:
        """Picture tokens [1,257,1280] of `image [3,H,W]` in 0..1."""
        ...


class TrainedParts:
    """The public networks; the encoders are read before the U-Net.

    The encoder of pictures is kept for the next one if there is room for the U-Net beside it.
    Otherwise it is released after use, so that neither is in memory together with another. The
    text is always the same and is encoded once.
    """

    def __init__(
        self,
        weights: str | os.PathLike[str] | None,
        device: str,
        dtype: torch.dtype,
        unet_dtype: torch.dtype | None = None,
    ) -> None:
        self._files = require("imagedream", weights)
        self._place = {"device": device, "dtype": dtype}
        self._unet_dtype = unet_dtype or dtype
        self._vision: Any = None
        vae = encoders.vae(self._files["vae/diffusion_pytorch_model.safetensors"])
        # Past diffusers' own `to`, which complains about a precision that is not mixed here.
        self.vae = nn.Module.to(vae, **self._place)

    @cached_property
    def unet(self) -> Any:
        """The network that predicts noise."""
        file = self._files["unet/diffusion_pytorch_model.safetensors"]
        return load_unet(file, **{**self._place, "dtype": self._unet_dtype})

    def text(self) -> Tensor:
        """Text tokens [1,77,1024]."""
        return self._text

    @cached_property
    def _text(self) -> Tensor:
        encoder = encoders.text_encoder(self._files["text_encoder/model.safetensors"])
        return encoders.empty_prompt(encoder.to(**self._place))

    def picture(self, image: Tensor) -> Tensor:
        """Picture tokens [1,257,1280]."""
        encoder = self._vision
        if encoder is None:
            encoder = encoders.image_encoder(self._files["image_encoder/model.safetensors"])
            encoder = encoder.to(**self._place)
        room = BESIDE * PARAMETERS * (self._unet_dtype.itemsize)
        self._vision = None if is_short(room, str(self._place["device"])) else encoder
        return encoders.picture_tokens(encoder, image)


class ImageDream:
    """Turns a picture into four views; `parts` replaces the trained networks in tests.

    `dtype` is the precision of the networks, `unet_dtype` that of the U-Net if it differs: the
    latents and the steps stay in `dtype`.
    """

    def __init__(
        self,
        *,
        weights: str | os.PathLike[str] | None = None,
        device: str = "cpu",
        dtype: torch.dtype = torch.float32,
        unet_dtype: torch.dtype | None = None,
        steps: int = STEPS,
        sampler: Sampler = "ddim",
        guidance: float = 5.0,
        elevation: float = 0.0,
        parts: Parts | None = None,
    ) -> None:
        self.weights, self.device, self.dtype = weights, device, dtype
        self.unet_dtype = unet_dtype or dtype
        self.steps = steps
        self.sampler: Sampler = sampler
        self.guidance, self.elevation = guidance, elevation
        self.parts = parts

    @torch.inference_mode()
    def __call__(self, image: Tensor, *, seed: int = 0, progress: Progress = silent) -> Tensor:
        """Views [5,3,256,256] in 0..1 of `image [3,H,W]` over white.

        They are at azimuths 0, 90, 180, 270 degrees, followed by the picture. Equal seeds give
        equal views on every device up to rounding. `progress` is called before each step and may
        cancel.
        """
        progress("imagedream", 0, self.steps)
        if self.parts is None:
            self.parts = TrainedParts(self.weights, self.device, self.dtype, self.unet_dtype)
        parts, draw = self.parts, torch.Generator().manual_seed(seed)
        condition = look(parts, image, draw, elevation=self.elevation).to(self.unet_dtype)
        noise = torch.randn(FRAMES, *condition.latents.shape[1:], generator=draw)
        latents = noise.to(self.device, self.dtype)
        stages = denoise(
            parts.unet, latents, condition, self.steps, self.guidance, sampler=self.sampler
        )
        for i, latents in enumerate(stages, 1):  # noqa: B007 (the last one is used)
            progress("imagedream", i, self.steps)
        return decode(parts.vae, latents)


def look(
    parts: Parts, image: Tensor, draw: torch.Generator, *, elevation: float = 0.0
) -> Condition:
    """Encode `image [3,H,W]` in 0..1 for the networks; both prompts are empty.

    Args:
        parts: The networks.
        image: The picture.
        draw: Source of normal samples.
        elevation: Of the picture, degrees; positive is below the object.
    """
    place = next(parts.vae.parameters())
    return Condition(
        text=parts.text().expand(2, -1, -1).to(place),
        tokens=parts.picture(image).to(place),
        latents=encode(parts.vae, image.to(place), draw),
        cameras=torch.from_numpy(cameras(elevation)).to(place),
    )


def encode(vae: Any, image: Tensor, draw: torch.Generator | None = None) -> Tensor:
    """Latents [1,4,32,32] of `image [3,H,W]` in 0..1: a scaled sample of the posterior."""
    square = interpolate(image[None], (SIZE, SIZE), mode="bilinear", align_corners=False)
    posterior = vae.encode(2 * square - 1).latent_dist
    noise = torch.randn(posterior.mean.shape, generator=draw).to(posterior.mean)
    return (posterior.mean + posterior.std * noise) * vae.config.scaling_factor


def decode(vae: Any, latents: Tensor) -> Tensor:
    """Pictures [F,3,H,W] in 0..1 of latents [F,4,h,w], one at a time to save memory."""
    pictures = [vae.decode(z[None] / vae.config.scaling_factor).sample[0] for z in latents]
    return (torch.stack(pictures) / 2 + 0.5).clamp(0, 1)


def denoise(
    unet: Any,
    latents: Tensor,
    condition: Condition,
    steps: int,
    guidance: float,
    *,
    sampler: Sampler = "ddim",
) -> Iterator[Tensor]:
    """Yield the latents [5,4,h,w] after each step.

    Args:
        unet: Predicts noise.
        latents: Noise to start from [5,4,h,w].
        condition: What the prediction depends on.
        steps: Number of steps.
        guidance: Scale of the classifier-free guidance.
        sampler: How the steps are taken.
    """
    scheduler = scheduler_of(sampler, steps)
    for t in scheduler.timesteps:
        noise = guided(unet, latents, t, condition, guidance)
        latents = scheduler.step(noise, t, latents, return_dict=False)[0]
        yield latents


def guided(unet: Any, latents: Tensor, t: Tensor, condition: Condition, guidance: float) -> Tensor:
    """Noise [5,4,h,w] predicted with the picture, pushed away from the prediction without it.

    Args:
        unet: Predicts noise.
        latents: [5,4,h,w].
        t: Noise level, 0 to 999.
        condition: What the prediction depends on.
        guidance: Scale of the classifier-free guidance.
    """
    without, with_it = predict(unet, latents, t, condition).chunk(2)
    return without + guidance * (with_it - without)


def predict(unet: Any, latents: Tensor, t: Tensor, condition: Condition) -> Tensor:
    """Noise [10,4,h,w] in the latents' precision: five frames without the picture, then with it.

    Args:
        unet: Predicts noise.
        latents: [5,4,h,w].
        t: Noise level, 0 to 999.
        condition: What the prediction depends on, in the network's precision.
    """
    frames = len(latents)
    tokens = condition.tokens.expand(frames, -1, -1)
    return unet(
        latents.repeat(2, 1, 1, 1).to(condition.latents),
        t.to(latents.device).expand(2 * frames),
        condition.text.repeat_interleave(frames, dim=0),
        num_frames=frames,
        camera=condition.cameras.repeat(2, 1),
        ip=torch.cat([torch.zeros_like(tokens), tokens]),
        ip_img=torch.cat([torch.zeros_like(condition.latents), condition.latents]),
    ).to(latents.dtype)
