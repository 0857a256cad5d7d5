"""Guidance for DreamGaussian: how unseen sides should look, by score distillation.

Poole et al. 2023, "DreamFusion": pictures are noised, a diffusion model predicts the noise, and the
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
"""First and last beta of Stable Diffusion's schedule, which is linear in the square root."""


class Pose(NamedTuple):
    """Position of a camera, relative to the known view."""

    elevation: float
    """Degrees; positive is below the object."""
    azimuth: float
    """Degrees."""
    radius: float


class Guidance(Protocol):
    """Judges pictures. `views` is the number it takes at once; four are a quarter turn apart."""

    views: int

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Loss (a scalar) of `images [B,3,S,S]` in 0..1 seen from `poses`.

        Args:
            images: The pictures.
            poses: Where they were taken from.
            ratio: Progress of the optimisation, 0..1; there is less noise towards the end.
            draw: Source of normal samples.
        """
        ...


def timestep(ratio: float) -> int:
    """Return the guidance's noise level at the progress `ratio` of the optimisation, 0..1."""
    return min(max(round((1 - ratio) * STEPS), T_MIN), T_MAX)


def alphas_cumprod() -> Tensor:
    """Fraction of the picture that remains at each of the 1000 noise levels, float64 [1000]."""
    first, last = (beta**0.5 for beta in BETAS)
    betas = torch.linspace(first, last, STEPS, dtype=torch.float64) ** 2
    return torch.cumprod(1 - betas, dim=0)


def add_noise(latents: Tensor, noise: Tensor, level: int) -> Tensor:
    """Add noise of a level to latents, keeping unit variance."""
    alpha = float(alphas_cumprod()[level])
    return alpha**0.5 * latents + (1 - alpha) ** 0.5 * noise


def sds(latents: Tensor, predicted: Tensor, noise: Tensor, weight: float) -> Tensor:
    """Return a scalar loss whose gradient by the latents is `weight * (predicted - noise)`.

    .5 |z - stopgrad(z - w (eps - n))|^2, as DreamGaussian writes it, so that it has a value.

    Args:
        latents: The optimised latents.
        predicted: Noise that the model predicts.
        noise: Noise that was added.
        weight: Weight of the gradient.
    """
    gradient = torch.nan_to_num(weight * (predicted - noise))
    target = (latents - gradient).detach()
    return 0.5 * (latents.float() - target.float()).square().sum()
