"""Small objects made of Gaussians, and lattices of particles."""

from collections.abc import Sequence

import numpy as np

from phy124.gaussians import Gaussians
from phy124.selftest.inputs import shell


def ball(count: int = 2000, radius: float = 0.5) -> Gaussians:
    """A closed shell of flat Gaussians on a sphere, coloured by direction."""
    return shell(count, radius)


def random_gaussians(rng: np.random.Generator, count: int = 50, degree: int = 0) -> Gaussians:
    """Of any place, shape and colour; spherical harmonics up to `degree`."""
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3))
    scales, opacities = np.exp(rng.normal(size=(count, 3)) - 4), rng.random(count)
    return Gaussians(rng.normal(size=(count, 3)), quats, scales, opacities, sh)


def lattice(*counts: int, spacing: float, corner: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    """Particles [N,3] in the middles of cubes of edge `spacing`, which fill a box from `corner`."""
    lines = [(np.arange(count) + 0.5) * spacing for count in counts]
    return np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3) + np.asarray(corner)


def block(
    per_axis: int = 6, size: float = 0.375, middle: Sequence[float] = (0, 0, 0)
) -> np.ndarray:
    """Particles [N,3] on a lattice in a cube of edge `size` around `middle`, m."""
    corner = np.asarray(middle, float) - size / 2
    return lattice(*[per_axis] * 3, spacing=size / per_axis, corner=corner)
