"""Guidance for DreamGaussian: score distillation, a loss for sides that the image does not show.

Poole et al. 2023, "DreamFusion": noise is added to images, and a diffusion model predicts this
noise. The gradient is the predicted noise minus the added noise. A guidance is any callable with
the signature of `Guidance`.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

STEPS = 1000
T_MIN, T_MAX = 20, 980
BETAS = (0.00085, 0.012)
"""First and last beta of Stable Diffusion's schedule; the square root of beta varies linearly."""


class Pose(NamedTuple):
    """Pose of a camera relative to the camera of the input image."""

    elevation: float
    """Elevation [degrees], which is positive if the camera is below the object."""
    azimuth: float
    """Azimuth [degrees]."""
    radius: float


class Guidance(Protocol):
    """Computes a loss for `views` images at a time. If `views` is 4, they are 90 degrees apart."""

    views: int

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Return the loss (a scalar) of rendered images.

        Args:
            images: The images [B,3,S,S], 0..1.
            poses: Camera poses of the images.
            ratio: Progress of the optimisation, 0..1; the noise level falls as the progress rises.
            draw: Random number generator for normal samples.
        """
        ...


def timestep(ratio: float) -> int:
    """Return the noise level of the guidance at the progress `ratio` of the optimisation, 0..1."""
    return min(max(round((1 - ratio) * STEPS), T_MIN), T_MAX)


def alphas_cumprod() -> Tensor:
    """Return the fraction [1000] of the signal that remains at each of 1000 noise levels."""
    first, last = (beta**0.5 for beta in BETAS)
    betas = torch.linspace(first, last, STEPS, dtype=torch.float64) ** 2
    return torch.cumprod(1 - betas, dim=0)


def add_noise(latents: Tensor, noise: Tensor, level: int) -> Tensor:
    """Add noise to latents at one noise level; latents of variance 1 keep this variance."""
    alpha = float(alphas_cumprod()[level])
    return alpha**0.5 * latents + (1 - alpha) ** 0.5 * noise


def sds(latents: Tensor, predicted: Tensor, noise: Tensor, weight: float) -> Tensor:
    """Return a scalar loss with the gradient `weight * (predicted - noise)` for the latents.

    The loss is .5 |z - stopgrad(z - w (eps - n))|^2, as in DreamGaussian's program.

    Args:
        latents: Latents that are optimised.
        predicted: Noise that the model predicts.
        noise: Noise that was added.
        weight: Weight of the gradient.
    """
    gradient = torch.nan_to_num(weight * (predicted - noise))
    target = (latents - gradient).detach()
    return 0.5 * (latents.float() - target.float()).square().sum()
