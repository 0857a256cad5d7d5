"""Samples of Gaussians, and the material at an object's surface as cubes that are cut by planes.

The unit of length is a voxel.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.particles.cuts import between

Array = NDArray[Any]
Mask = NDArray[np.bool_]


class Samples(NamedTuple):
    """Sample points in the Gaussians."""

    points: Array
    """Positions from the lower corner of the grid [S,3]."""
    owner: Array
    """Index of the Gaussian of each sample [S]."""
    normals: Array
    """Shortest axes of the Gaussians [N,3]; zero for Gaussians that are not flat."""
    thickness: Array
    """Twice the shortest standard deviations [N]."""
    opacities: Array
    lengths: Array
    """Twice the longest standard deviations [N]."""


class Cubes(NamedTuple):
    """Cubes of equal side, with material between two parallel planes."""

    voxel: Array
    """Index of each cube's voxel in the flattened grid [B]."""
    corner: Array
    """Lower corners [B,3]."""
    weight: Array
    """Filled fraction between the planes [B]."""
    normal: Array
    """Unit normals of the planes [B,3]."""
    upper: Array
    """Height of the upper plane above the middle of each cube [B]."""
    lower: Array
    """Height of the lower plane above the middle of each cube [B]."""

    def select(self, mask: Mask) -> "Cubes":
        """Return the cubes in a mask."""
        return Cubes(*(values[mask] for values in self))


class Surface(NamedTuple):
    """The material in the voxels at the surface of an object; other voxels are full or empty."""

    cubes: tuple[tuple[Cubes, int], ...]
    """Groups of cubes, and the number of cubes along each side of a voxel."""

    def fill(self, region: Mask) -> NDArray[np.float32]:
        """Return the filled fractions of all voxels [X,Y,Z], from a region and this surface."""
        fraction = region.ravel().astype(np.float64)
        for cubes, parts in self.cubes:
            fraction[cubes.voxel] = 0
            middle, thick = (cubes.upper + cubes.lower) / 2, cubes.upper - cubes.lower
            volume = cubes.weight * between(cubes.normal, middle, thick, 1 / parts)
            fraction += np.bincount(cubes.voxel, volume, region.size)
        return np.clip(fraction, 0, 1).reshape(region.shape).astype(np.float32)


def parts_of(corner: Array, parts: int) -> Array:
    """Return the lower corners [V,P,3] of the parts of voxels with lower corners `corner` [V,3]."""
    line = np.arange(parts) / parts
    inner = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(corner[:, None] + inner)
