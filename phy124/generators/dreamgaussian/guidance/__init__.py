"""What tells DreamGaussian how unseen sides should look: score distillation by a diffusion model.

Poole et al. 2023, "DreamFusion": pictures are noised, the model predicts the noise, and the
difference is the gradient. A guidance is any callable of the shape of `Guidance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

STEPS = 1000
T_MIN, T_MAX = 20, 980
BETAS = (0.00085, 0.012)
"""First and last beta of Stable Diffusion's schedule, linear in the square root."""


class Pose(NamedTuple):
    """Where a picture is taken from, relative to the known view."""

    elevation: float
    """Degrees; positive is below the object."""
    azimuth: float
    """Degrees."""
    radius: float


class Guidance(Protocol):
    """Judges pictures; `views` is how many it wants at once, in quarter turns if four."""

    views: int

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Loss (a scalar) of `images [B,3,S,S]` in 0..1 seen from `poses`.

        `ratio` in 0..1 is how far the optimisation is: less noise towards the end.
        """
        ...


def timestep(ratio: float) -> int:
    """Noise level of the guidance when the optimisation is at `ratio`."""
    return min(max(round((1 - ratio) * STEPS), T_MIN), T_MAX)


def alphas_cumprod() -> Tensor:
    """Share of the picture left at each of the 1000 noise levels, float64 [1000]."""
    first, last = (beta**0.5 for beta in BETAS)
    betas = torch.linspace(first, last, STEPS, dtype=torch.float64) ** 2
    return torch.cumprod(1 - betas, dim=0)


def noised(latents: Tensor, noise: Tensor, level: int) -> Tensor:
    """Latents with noise of a level, keeping unit variance."""
    alpha = float(alphas_cumprod()[level])
    return alpha**0.5 * latents + (1 - alpha) ** 0.5 * noise


def sds(latents: Tensor, predicted: Tensor, noise: Tensor, weight: float) -> Tensor:
    """Loss whose gradient by the latents is `weight * (predicted - noise)`; a scalar.

    .5 |z - stopgrad(z - w (eps - n))|^2, as DreamGaussian writes it, so that it has a value.
    """
    gradient = torch.nan_to_num(weight * (predicted - noise))
    target = (latents - gradient).detach()
    return 0.5 * (latents.float() - target.float()).square().sum()
