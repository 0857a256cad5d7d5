"""Guidance for DreamGaussian: score distillation, a loss for sides that the image does not show.

Poole et al. 2023, "DreamFusion": the gradient is the noise that a diffusion model predicts, minus
the noise that was added.
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
    """Pose of a camera relative to the input image's camera."""

    elevation: float
    """Elevation [degrees], positive below the object."""
    azimuth: float
    """Azimuth [degrees]."""
    radius: float


class Guidance(Protocol):
    """Computes a loss for rendered images."""

    def __call__(
        self, images: Tensor, poses: Sequence[Pose], ratio: float, draw: torch.Generator
    ) -> Tensor:
        """Return the loss (a scalar) of rendered images.

        Args:
            images: The images [B,3,S,S], 0..1.
            poses: Camera poses of the images.
            ratio: Finished fraction of the optimisation, which determines the noise level.
            draw: Random number generator.
        """
        ...


def timestep(ratio: float) -> int:
    """Return the noise level at the finished fraction `ratio` of the optimisation."""
    return min(max(round((1 - ratio) * STEPS), T_MIN), T_MAX)


def alphas_cumprod() -> Tensor:
    """Return the fraction [1000] of the signal that remains at each noise level."""
    first, last = (beta**0.5 for beta in BETAS)
    betas = torch.linspace(first, last, STEPS, dtype=torch.float64) ** 2
    return torch.cumprod(1 - betas, dim=0)


def add_noise(latents: Tensor, noise: Tensor, level: int) -> Tensor:
    """Add noise to latents; latents of variance 1 keep this variance."""
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
