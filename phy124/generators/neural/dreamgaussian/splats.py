"""The Gaussians that DreamGaussian optimises: parameters and an Adam optimiser.

Kerbl et al. 2023, "3D Gaussian Splatting", section 5, with the learning rates of Tang et al. 2024,
"DreamGaussian". Colours do not depend on the direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from phy124.gaussians import SH_C0, Gaussians
from phy124.generators.neural.orbit import to_world
from phy124.generators.neural.splatting import Rendering, View, rasterize, rotation_matrices

Parameters = dict[str, Tensor]
"""xyz [N,3]; f_dc [N,1,3] harmonics; opacity [N,1] logits; scaling [N,3] logs; rotation [N,4]."""
NEIGHBOURS = 3
SMALLEST = 1e-7
"""Smallest mean squared distance to neighbours, which keeps the logarithm finite."""
START_OPACITY = 0.1


@dataclass(frozen=True)
class Rates:
    """Learning rates of Adam; the rate of the centres decreases from `xyz` to `xyz_last`."""

    xyz: float = 0.01
    xyz_last: float = 0.0002
    f_dc: float = 0.01
    opacity: float = 0.05
    scaling: float = 0.005
    rotation: float = 0.005
    steps: int = 500
    """Number of steps in which the centres' learning rate decreases."""

    def position(self, step: int) -> float:
        """Return the learning rate of the centres; its logarithm is linear in the step."""
        t = min(1.0, step / self.steps)
        return math.exp((1 - t) * math.log(self.xyz) + t * math.log(self.xyz_last))


class Splats:
    """Gaussians that can be rendered and optimised."""

    def __init__(self, parameters: Parameters, rates: Rates | None = None) -> None:
        self.rates = rates or Rates()
        self.parameters = {
            name: value.detach().clone().requires_grad_() for name, value in parameters.items()
        }
        groups = [
            {"params": [value], "lr": getattr(self.rates, name), "name": name}
            for name, value in self.parameters.items()
        ]
        self.optimizer = torch.optim.Adam(groups, lr=0.0, eps=1e-15)

    @classmethod
    def from_points(cls, points: Tensor, colors: Tensor, rates: Rates | None = None) -> Splats:
        """Create spherical Gaussians at points [N,3]; their scale is the distance to neighbours."""
        n = len(points)
        mean = neighbour_distances(points).clamp(min=SMALLEST)
        parameters = {
            "xyz": points,
            "f_dc": ((colors - 0.5) / SH_C0)[:, None, :],
            "opacity": torch.full_like(
                points[:, :1], math.log(START_OPACITY / (1 - START_OPACITY))
            ),
            "scaling": (0.5 * mean.log())[:, None].repeat(1, 3),
            "rotation": torch.eye(4, dtype=points.dtype, device=points.device)[:1].repeat(n, 1),
        }
        return cls(parameters, rates)

    def __len__(self) -> int:
        return len(self.parameters["xyz"])

    @property
    def scales(self) -> Tensor:
        """Standard deviations [N,3]."""
        return self.parameters["scaling"].exp()

    @property
    def opacities(self) -> Tensor:
        """Opacities [N], 0..1."""
        return self.parameters["opacity"][:, 0].sigmoid()

    def render(self, view: View, background: Tensor) -> Rendering:
        """Render the Gaussians over a background [3]."""
        p = self.parameters
        colors = (0.5 + SH_C0 * p["f_dc"][:, 0]).clamp(min=0)
        return rasterize(
            p["xyz"], p["rotation"], self.scales, self.opacities, colors, view, background
        )

    def set_step(self, step: int) -> None:
        """Set the learning rate of the Gaussians' centres."""
        for group in self.optimizer.param_groups:
            if group["name"] == "xyz":
                group["lr"] = self.rates.position(step)

    def step(self) -> None:
        """Take one step of Adam, then clear the gradients."""
        self.optimizer.step()
        self.optimizer.zero_grad()

    def keep(self, mask: Tensor) -> None:
        """Keep only the Gaussians in a mask [N]."""
        self._replace({k: (v[mask], lambda m: m[mask]) for k, v in self.parameters.items()})

    def append(self, more: Parameters) -> None:
        """Add Gaussians, with Adam moments of zero."""
        self._replace(
            {
                name: (
                    torch.cat([value, more[name]]),
                    lambda m, new=more[name]: torch.cat([m, torch.zeros_like(new)]),
                )
                for name, value in self.parameters.items()
            }
        )

    def overwrite(self, name: str, value: Tensor) -> None:
        """Replace one parameter of all Gaussians, and set its Adam moments to zero."""
        self._replace({name: (value, torch.zeros_like)})

    def _replace(self, changes: dict) -> None:
        """`changes[name]` contains the new value, and a function that converts the Adam moments."""
        for group in self.optimizer.param_groups:
            if group["name"] not in changes:
                continue
            value, momentum = changes[group["name"]]
            (old,) = group["params"]
            state = self.optimizer.state.pop(old, {})
            new = value.detach().clone().requires_grad_()
            for key in ("exp_avg", "exp_avg_sq"):
                if key in state:
                    state[key] = momentum(state[key])
            group["params"] = [new]
            if state:
                self.optimizer.state[new] = state
            self.parameters[group["name"]] = new

    @torch.no_grad()
    def gaussians(self) -> Gaussians:
        """Return the Gaussians in the axes of phy124."""
        p = self.parameters
        quats = torch.nn.functional.normalize(p["rotation"])
        parts = (p["xyz"], quats, self.scales, self.opacities, p["f_dc"])
        return to_world(Gaussians(*(np.asarray(part.cpu()) for part in parts)))


def neighbour_distances(points: Tensor) -> Tensor:
    """Return the mean squared distance [N] to the three nearest neighbours."""
    squared = torch.cdist(points, points).square().fill_diagonal_(math.inf)
    return squared.topk(min(NEIGHBOURS, len(points) - 1), largest=False).values.mean(dim=1)


def ball(count: int, radius: float, draw: torch.Generator) -> Tensor:
    """Return points [count,3] in a ball."""
    u, v, w = torch.rand(3, count, generator=draw)
    azimuth, z = 2 * math.pi * u, 2 * v - 1
    ring = torch.sqrt(1 - z * z)
    directions = torch.stack([ring * azimuth.cos(), ring * azimuth.sin(), z], dim=1)
    return radius * w[:, None] ** (1 / 3) * directions


CHILDREN = 2
SHRINK = 0.8 * CHILDREN
"""Ratio of a Gaussian's scales to the scales of the two Gaussians that replace it in a split."""
TOO_LARGE = 0.1
"""Largest scale of a Gaussian that is kept, relative to the scene's size."""
RESET = 0.01
Draw = Callable[[Tensor], Tensor]
"""Maps standard deviations [M,3] to normal samples [M,3]."""


@dataclass(frozen=True)
class Density:
    """Schedule and thresholds of densification; steps are counted from 1."""

    start: int = 100
    end: int = 3000
    every: int = 100
    gradient: float = 0.01
    """Smallest screen gradient at which a Gaussian is cloned or split."""
    extent: float = 4.0
    percent_dense: float = 0.01
    """Largest scale of a cloned Gaussian, relative to the scene's size; larger ones are split."""
    opacity_min: float = 0.01
    reset_every: int = 700
    """Number of steps between resets of the opacity."""


class Pull:
    """Gradient of the loss with respect to each Gaussian's screen position, averaged over several
    views.
    """

    def __init__(self, count: int, device: torch.device | str = "cpu") -> None:
        self.total = torch.zeros(count, device=device)
        self.seen = torch.zeros(count, device=device)

    def add(self, gradients: Tensor, visible: Tensor) -> None:
        """Add the lengths of gradients [N,2 or 3] on the screen where `visible [N]` is true."""
        length = gradients[:, :2].norm(dim=1)
        self.total += torch.where(visible, length, torch.zeros_like(length))
        self.seen += visible

    def add_rendering(self, rendering: Rendering) -> None:
        """Add the gradients of a rendering after the backward pass."""
        self.add(rendering.screen_gradients(), rendering.radii > 0)

    @property
    def mean(self) -> Tensor:
        """Mean length [N] of the gradients; 0 if a Gaussian was never visible."""
        return self.total / self.seen.clamp(min=1)


def normal_draw(generator: torch.Generator) -> Draw:
    """Return a function that draws normal samples on the CPU, so that all devices get equal
    samples.
    """
    return lambda std: std * torch.randn(std.shape, generator=generator).to(std)


@torch.no_grad()
def densify(splats: Splats, pull: Tensor, density: Density, draw: Draw) -> None:
    """Clone, split and prune Gaussians in place.

    Args:
        splats: The Gaussians; they are changed.
        pull: Mean screen gradients [N].
        density: Thresholds.
        draw: Draws normal samples.
    """
    small = density.percent_dense * density.extent
    largest, pulled = splats.scales.amax(dim=1), pull >= density.gradient
    split = pulled & (largest > small)
    clones = {k: v[pulled & (largest <= small)] for k, v in splats.parameters.items()}
    splats.append(clones)
    _split(splats, torch.cat([split, split.new_zeros(len(clones["xyz"]))]), draw)
    prune(splats, opacity_min=density.opacity_min, extent=density.extent)


def _split(splats: Splats, mask: Tensor, draw: Draw) -> None:
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
    """Remove Gaussians that are nearly transparent or larger than a tenth of the scene."""
    large = splats.scales.amax(dim=1) > TOO_LARGE * extent
    splats.keep(~((splats.opacities < opacity_min) | large))


@torch.no_grad()
def reset_opacity(splats: Splats) -> None:
    """Limit all opacities to `RESET`; the optimisation then raises opacities where needed."""
    splats.overwrite("opacity", torch.logit(splats.opacities.clamp(max=RESET))[:, None])
