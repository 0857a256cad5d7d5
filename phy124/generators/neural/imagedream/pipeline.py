"""ImageDream's sampling: makes four views of an object from one image.

Wang & Shi 2023, "ImageDream"; classifier-free guidance (Ho & Salimans 2022). A fifth frame contains
the image itself; LGM does not use this frame.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate

from phy124.generators.neural.imagedream import PARAMETERS, STEPS, encoders
from phy124.generators.neural.imagedream.unet import load_unet
from phy124.generators.neural.orbit import orbit
from phy124.generators.neural.precision import is_short
from phy124.generators.options import Sampler
from phy124.progress import Progress, silent
from phy124.weights.store import require

NOISE: dict[str, Any] = {
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
    "num_train_timesteps": 1000,
    "steps_offset": 1,
    "prediction_type": "epsilon",
    "timestep_spacing": "leading",
}
SCHEDULE = {**NOISE, "clip_sample": False, "set_alpha_to_one": False}
"""Noise schedule for DDIM."""


def scheduler_of(sampler: Sampler, steps: int) -> Any:
    """Return a diffusers scheduler for a number of steps."""
    if sampler == "ddim":
        scheduler: Any = DDIMScheduler(**SCHEDULE)
    else:
        # With these settings, the last noise level is as low as with DDIM.
        scheduler = DPMSolverMultistepScheduler(
            **{**NOISE, "timestep_spacing": "linspace"},
            use_lu_lambdas=True,
            final_sigmas_type="sigma_min",
        )
    scheduler.set_timesteps(steps)
    return scheduler


AZIMUTHS = (0, 90, 180, 270)
"""Azimuths of the four views [degrees]."""


def cameras(elevation: float = 0.0) -> NDArray[np.float32]:
    """Return the camera-to-world transforms of the four views, and zeros for the image [5,16].

    Transforms are flattened row by row. A camera with a positive `elevation` [degrees] is below the
    object.
    """
    rows = [pose_row(elevation, azimuth) for azimuth in AZIMUTHS]
    return np.array([*rows, [0.0] * 16], dtype=np.float32)


def pose_row(elevation: float, azimuth: float) -> list[float]:
    """Return the camera-to-world transform (16 numbers) at distance 1; z is up."""
    pose = orbit(elevation, azimuth, 1.0)[[0, 2, 1, 3]]
    return (pose * np.array([1.0, -1.0, 1.0, 1.0])[:, None]).reshape(16).tolist()


SPARE_UNETS = 2.0
"""If the free memory, relative to the U-Net's size, is larger, the image encoder stays in
memory.
"""
FRAMES = 5
"""Number of frames: four views and the image."""
SIZE = 256
"""Side of each view [pixels]; the latents have an eighth of this side."""


@dataclass(frozen=True)
class Condition:
    """Conditions for predicting the noise without and with the image."""

    text: Tensor
    """Text tokens [2,77,D] of the negative prompt and of the prompt."""
    tokens: Tensor
    """Image tokens [1,257,1280]; zeros without the image."""
    latents: Tensor
    """Image latents [1,4,h,w]; zeros without the image."""
    cameras: Tensor
    """Camera-to-world transforms [5,16]."""

    def to(self, dtype: torch.dtype) -> Condition:
        """Convert all tensors to a precision."""
        return Condition(*(tensor.to(dtype) for tensor in vars(self).values()))


class Parts(Protocol):
    """The networks of ImageDream."""

    unet: Any
    vae: Any

    def text(self) -> Tensor:
        """Return the text tokens [1,77,D] of the empty prompt."""
        ...

    def picture(self, image: Tensor) -> Tensor:
        """Return the image tokens [1,257,1280] of an image [3,H,W] in 0..1."""
        ...


class TrainedParts:
    """Loads the public networks when they are needed.

    If memory suffices, the image encoder is kept for the next image.
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
        # diffusers' own `to` is bypassed: it warns about mixed precision, which does not occur.
        self.vae = nn.Module.to(vae, **self._place)

    @cached_property
    def unet(self) -> Any:
        """The network that predicts the noise."""
        file = self._files["unet/diffusion_pytorch_model.safetensors"]
        return load_unet(file, **{**self._place, "dtype": self._unet_dtype})

    def text(self) -> Tensor:
        """Return the text tokens [1,77,1024] of the empty prompt."""
        return self._text

    @cached_property
    def _text(self) -> Tensor:
        encoder = encoders.text_encoder(self._files["text_encoder/model.safetensors"])
        return encoders.empty_prompt(encoder.to(**self._place))

    def picture(self, image: Tensor) -> Tensor:
        """Return the image tokens [1,257,1280] of an image [3,H,W] in 0..1."""
        encoder = self._vision
        if encoder is None:
            encoder = encoders.image_encoder(self._files["image_encoder/model.safetensors"])
            encoder = encoder.to(**self._place)
        room = SPARE_UNETS * PARAMETERS * (self._unet_dtype.itemsize)
        self._vision = None if is_short(room, str(self._place["device"])) else encoder
        return encoders.picture_tokens(encoder, image)


class ImageDream:
    """Turns an image into four views of the object; `parts` replaces the networks in tests.

    `dtype` is the precision of the networks and latents. `unet_dtype` is the precision of the
    U-Net.
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
        """Return views [5,3,256,256] in 0..1 of the object in `image [3,H,W]` over white.

        The azimuths are 0, 90, 180 and 270 degrees; the fifth view is the image. Equal seeds give
        equal views on every device, up to rounding.
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
    """Encode an image [3,H,W] in 0..1 for the networks.

    Args:
        parts: The networks.
        image: The image.
        draw: Random number generator.
        elevation: Elevation of the camera [degrees]; positive is below the object.
    """
    place = next(parts.vae.parameters())
    return Condition(
        text=parts.text().expand(2, -1, -1).to(place),
        tokens=parts.picture(image).to(place),
        latents=encode(parts.vae, image.to(place), draw),
        cameras=torch.from_numpy(cameras(elevation)).to(place),
    )


def encode(vae: Any, image: Tensor, draw: torch.Generator | None = None) -> Tensor:
    """Return the latents [1,4,32,32] of an image [3,H,W]: a scaled sample of the posterior."""
    square = interpolate(image[None], (SIZE, SIZE), mode="bilinear", align_corners=False)
    posterior = vae.encode(2 * square - 1).latent_dist
    noise = torch.randn(posterior.mean.shape, generator=draw).to(posterior.mean)
    return (posterior.mean + posterior.std * noise) * vae.config.scaling_factor


def decode(vae: Any, latents: Tensor) -> Tensor:
    """Decode latents [F,4,h,w] to images [F,3,H,W] in 0..1, one by one to save memory."""
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
        unet: Network that predicts the noise.
        latents: Initial noise [5,4,h,w].
        condition: Conditions.
        steps: Number of steps.
        guidance: Scale of the classifier-free guidance.
        sampler: Solver of the diffusion.
    """
    scheduler = scheduler_of(sampler, steps)
    for t in scheduler.timesteps:
        noise = predict_guided(unet, latents, t, condition, guidance)
        latents = scheduler.step(noise, t, latents, return_dict=False)[0]
        yield latents


def predict_guided(
    unet: Any, latents: Tensor, t: Tensor, condition: Condition, guidance: float
) -> Tensor:
    """Predict the noise [5,4,h,w] by classifier-free guidance.

    Args:
        unet: Network that predicts the noise.
        latents: Latents [5,4,h,w].
        t: Noise level, 0 to 999.
        condition: Conditions.
        guidance: Scale of the guidance.
    """
    without, with_it = predict(unet, latents, t, condition).chunk(2)
    return without + guidance * (with_it - without)


def predict(unet: Any, latents: Tensor, t: Tensor, condition: Condition) -> Tensor:
    """Predict the noise [10,4,h,w] of five frames without the image, then with the image.

    Args:
        unet: Network that predicts the noise.
        latents: Latents [5,4,h,w].
        t: Noise level, 0 to 999.
        condition: Conditions of the prediction, in the network's precision.
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
