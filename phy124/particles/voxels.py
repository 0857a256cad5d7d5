"""Outward normals of a body's voxels, from the filled fractions of their neighbours."""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.resampling import Material

SHEET = 0.25
"""A voxel with a shorter gradient has no single outward side [1/voxel]."""
NEAR = np.array(list(np.ndindex(3, 3, 3))) - 1
SLOPES = 3 / 13 * NEAR / np.maximum((NEAR**2).sum(axis=1, keepdims=True), 1)
"""Weights of the 27 filled fractions in their gradient. The weight of a neighbour is proportional
to 1 / distance^2. At a plane parallel to a face of the voxels, the gradient has the length 1.
"""


class Voxels(NamedTuple):
    """The filled parts of the V voxels that are not empty; lengths are in voxels."""

    indices: NDArray[np.int64]
    """Indices of the voxels [V,3]."""
    fraction: NDArray[np.float64]
    """Filled fractions [V]."""
    normal: NDArray[np.float64]
    """Outward normals [V,3]; zero in sheets, which have no single outward side."""
    shift: NDArray[np.float64]
    """Centres of the filled parts, relative to the middles of the voxels [V,3]."""
    spread: NDArray[np.float64]
    """Second moments of the filled parts about their centres, divided by the volumes [V,3,3]."""


def find_voxels(filled: NDArray, material: Material | None = None) -> Voxels:
    """Return the filled parts of the voxels of a grid [X,Y,Z]; without `material`, all voxels are
    filled evenly.
    """
    filled = filled.astype(np.float64)
    index = np.argwhere(filled > 0)
    fraction, normal = filled[tuple(index.T)], np.zeros(index.shape)
    # The gradient is zero among full voxels.
    within = scipy.ndimage.minimum_filter(filled, 3, mode="constant")[tuple(index.T)] >= 1
    outer = np.flatnonzero(~within)
    normal[outer] = find_normals(filled, index[outer])
    if material is not None:  # It has the same voxels in the same order.
        return Voxels(index, fraction, normal, material.shift, material.spread)
    even = np.tile(np.eye(3) / 12, (len(index), 1, 1))
    return Voxels(index, fraction, normal, np.zeros(index.shape), even)


def find_normals(filled: NDArray, index: NDArray, least: float = SHEET) -> NDArray[np.float64]:
    """Return the outward normals of some voxels [V,3] of a grid; zero in sheets.

    Args:
        filled: Filled fractions of all voxels [X,Y,Z].
        index: Indices of the voxels [V,3].
        least: Smallest length of the gradient at voxels with a normal [1/voxel].
    """
    cubes = np.lib.stride_tricks.sliding_window_view(np.pad(filled, 1), (3, 3, 3))
    normal: NDArray[np.float64] = -cubes[tuple(index.T)].reshape(-1, 27) @ SLOPES
    length = np.linalg.norm(normal, axis=1)
    normal[length < least] = 0
    return normal / np.maximum(length, least)[:, None]
