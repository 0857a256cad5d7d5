"""Small analytic objects made of Gaussians, or of particles."""

import numpy as np

from phy124.gaussians import Gaussians, quaternions


def ball(count: int = 2000, radius: float = 0.5) -> Gaussians:
    """A closed shell of flat Gaussians on a sphere, coloured by direction."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    along = np.cross(normals, helper)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along), normals], axis=2)
    width = radius * np.sqrt(4 * np.pi / count)
    scales = np.tile([0.7 * width, 0.7 * width, 0.1 * width], (count, 1))
    return Gaussians.from_rgb(
        normals * radius, quaternions(axes), scales, np.full(count, 0.95), 0.5 + 0.4 * normals
    )


def block(per_axis: int = 6) -> np.ndarray:
    """Particles on a lattice in a cube of 0.375 m, 5 cm above the ground [N,3]."""
    line = (np.arange(per_axis) + 0.5) / per_axis * 0.375
    return np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3) + [0, 0, 0.05]
