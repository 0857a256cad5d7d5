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
"""ImageDream's own, for DDIM."""


def scheduler_of(sampler: Sampler, steps: int) -> Any:
    """Return the scheduler of diffusers for a number of steps, ready for the first."""
    if sampler == "ddim":
        scheduler: Any = DDIMScheduler(**SCHEDULE)
    else:
        # Its last step ends at the same little noise as DDIM's.
        scheduler = DPMSolverMultistepScheduler(
            **{**NOISE, "timestep_spacing": "linspace"},
            use_lu_lambdas=True,
            final_sigmas_type="sigma_min",
        )
    scheduler.set_timesteps(steps)
    return scheduler


AZIMUTHS = (0, 90, 180, 270)
"""Azimuths of the four views, degrees."""


def cameras(elevation: float = 0.0) -> NDArray[np.float32]:
    """Camera to world of the four views, and zeros for the picture itself [5,16], row by row.

    A positive elevation [degrees] is below the object, as in all of these networks.
    """
    rows = [pose_row(elevation, azimuth) for azimuth in AZIMUTHS]
    return np.array([*rows, [0.0] * 16], dtype=np.float32)


def pose_row(elevation: float, azimuth: float) -> list[float]:
    """Camera-to-world transform of one view at distance 1, 16 numbers; y up becomes z up."""
    pose = orbit(elevation, azimuth, 1.0)[[0, 2, 1, 3]]
    return (pose * np.array([1.0, -1.0, 1.0, 1.0])[:, None]).reshape(16).tolist()


SPARE_UNETS = 2.0
"""Free memory above which the picture's encoder is kept, in sizes of the U-Net."""
FRAMES = 5
"""Number of frames: four views and the picture."""
SIZE = 256
"""Side of each view, pixels; latents are an eighth of it."""


@dataclass(frozen=True)
class Condition:
    """Inputs of the noise prediction, without and with the picture."""

    text: Tensor
    """Text tokens [2,77,D]: negative prompt, prompt."""
    tokens: Tensor
    """Picture tokens [1,257,1280]; without the picture they are zeros."""
    latents: Tensor
    """Picture latents [1,4,h,w]; without the picture they are zeros."""
    cameras: Tensor
    """Poses [5,16]."""

    def to(self, dtype: torch.dtype) -> Condition:
        """Convert to a network's precision."""
        return Condition(*(tensor.to(dtype) for tensor in vars(self).values()))


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

    The picture's encoder is kept for the next picture if it fits into memory together with the
    U-Net. Otherwise it is released after use. The text is always the same and is encoded once.
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
        room = SPARE_UNETS * PARAMETERS * (self._unet_dtype.itemsize)
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
        noise = predict_guided(unet, latents, t, condition, guidance)
        latents = scheduler.step(noise, t, latents, return_dict=False)[0]
        yield latents


def predict_guided(
    unet: Any, latents: Tensor, t: Tensor, condition: Condition, guidance: float
) -> Tensor:
    """Extrapolate the noise [5,4,h,w] from the prediction without the picture to that with it.

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
    """Predict the noise [10,4,h,w]: of five frames without the picture, then of five with it.

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
