"""Where Gaussians are added and removed during the optimisation.

Kerbl et al. 2023, section 5.2, with DreamGaussian's thresholds: Gaussians with large screen
gradients are doubled (small ones cloned, large ones split), faint and huge ones are removed. The
rule for Gaussians that are large on the screen never fires there and is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from phy124.generators.neural.dreamgaussian.splats import Splats
from phy124.generators.neural.splatting import Rendering, rotation_matrices

CHILDREN = 2
SHRINK = 0.8 * CHILDREN
"""Factor by which the children of a split are smaller than their parent."""
TOO_LARGE = 0.1
"""Gaussians with scales above this multiple of the extent are removed."""
RESET = 0.01
Draw = Callable[[Tensor], Tensor]
"""Standard deviations [M,3] -> normal samples [M,3]."""


@dataclass(frozen=True)
class Density:
    """When and how densification acts; steps count from 1."""

    start: int = 100
    end: int = 3000
    every: int = 100
    gradient: float = 0.01
    """Screen gradient from which a Gaussian is doubled."""
    extent: float = 4.0
    """Size of the scene."""
    percent_dense: float = 0.01
    """Gaussians up to this multiple of the extent are cloned, larger ones split."""
    opacity_min: float = 0.01
    reset_every: int = 700
    """Steps between resets of the opacity; larger than the usual 500 steps."""


class Pull:
    """Mean length of each Gaussian's screen gradient since it was last emptied."""

    def __init__(self, count: int, device: torch.device | str = "cpu") -> None:
        self.total = torch.zeros(count, device=device)
        self.seen = torch.zeros(count, device=device)

    def add(self, gradients: Tensor, visible: Tensor) -> None:
        """Count `gradients [N,2 or 3]` (the first two are used) where `visible [N]`."""
        length = gradients[:, :2].norm(dim=1)
        self.total += torch.where(visible, length, torch.zeros_like(length))
        self.seen += visible

    def add_rendering(self, rendering: Rendering) -> None:
        """Count the gradients of a rendering after the backward pass."""
        self.add(rendering.screen_gradients(), rendering.radii > 0)

    @property
    def mean(self) -> Tensor:
        """Mean lengths [N]; 0 where never visible."""
        return self.total / self.seen.clamp(min=1)


def normal_draw(generator: torch.Generator) -> Draw:
    """Samples from a generator on the CPU, identical on every device."""
    return lambda std: std * torch.randn(std.shape, generator=generator).to(std)


@torch.no_grad()
def densify(splats: Splats, pull: Tensor, density: Density, draw: Draw) -> None:
    """Clone, split and prune Gaussians in place.

    Args:
        splats: The Gaussians; they are changed.
        pull: Mean screen gradients [N].
        density: Thresholds.
        draw: Source of normal samples.
    """
    small = density.percent_dense * density.extent
    largest, pulled = splats.scales.amax(dim=1), pull >= density.gradient
    split = pulled & (largest > small)
    clones = {k: v[pulled & (largest <= small)] for k, v in splats.parameters.items()}
    splats.append(clones)
    _split(splats, torch.cat([split, split.new_zeros(len(clones["xyz"]))]), draw)
    prune(splats, opacity_min=density.opacity_min, extent=density.extent)


def _split(splats: Splats, mask: Tensor, draw: Draw) -> None:
    """Replace each Gaussian in `mask [N]` by two smaller ones."""
    parents = {
        k: v[mask].repeat(CHILDREN, *[1] * (v.ndim - 1)) for k, v in splats.parameters.items()
    }
    offsets = draw(parents["scaling"].exp())
    turned = (rotation_matrices(parents["rotation"]) @ offsets[..., None])[..., 0]
    parents["xyz"] = parents["xyz"] + turned
    parents["scaling"] = parents["scaling"] - math.log(SHRINK)
    splats.append(parents)
    splats.keep(~torch.cat([mask, mask.new_zeros(len(parents["xyz"]))]))


@torch.no_grad()
def prune(splats: Splats, *, opacity_min: float, extent: float) -> None:
    """Remove Gaussians that are nearly transparent or larger than a tenth of the extent."""
    large = splats.scales.amax(dim=1) > TOO_LARGE * extent
    splats.keep(~((splats.opacities < opacity_min) | large))


@torch.no_grad()
def reset_opacity(splats: Splats) -> None:
    """Make everything nearly transparent, so that only what is needed becomes visible again."""
    splats.overwrite("opacity", torch.logit(splats.opacities.clamp(max=RESET))[:, None])
