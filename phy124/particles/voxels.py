"""Computes outward normals of a body's voxels from the filled fractions of their neighbours."""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.resampling import Material

SHEET = 0.25
"""A voxel has no single outward side if the length of the gradient of the filled fraction is below
this value [1/voxel].
"""
NEAR = np.array(list(np.ndindex(3, 3, 3))) - 1
"""Steps from a voxel to the 27 voxels within one step, including itself."""
SLOPES = 3 / 13 * NEAR / np.maximum((NEAR**2).sum(axis=1, keepdims=True), 1)
"""Weights with which the filled fractions of the 27 voxels around a voxel are summed to their
gradient. The weight of a neighbour is proportional to 1 / distance^2. At a plane parallel to a face
of the voxels, the gradient has the length 1.
"""


class Voxels(NamedTuple):
    """The filled parts of the V voxels that are not empty; the unit of length is a voxel."""

    indices: NDArray[np.int64]
    """Indices of the voxels [V,3]."""
    fraction: NDArray[np.float64]
    """Filled fractions of the voxels [V]."""
    normal: NDArray[np.float64]
    """Outward normals of the voxels [V,3]; zero in sheets, which have no single outward side."""
    shift: NDArray[np.float64]
    """Centres of the voxels' filled parts, relative to the middles of the voxels [V,3]."""
    spread: NDArray[np.float64]
    """Second moments of the voxels' filled parts about their centres, divided by the parts' volumes
    [V,3,3].
    """


def find_voxels(filled: NDArray, material: Material | None = None) -> Voxels:
    """Return the filled parts of the voxels of a grid.

    Args:
        filled: Filled fractions [X,Y,Z].
        material: Centres and second moments of the filled parts. If None, every voxel is filled
            evenly.
    """
    filled = filled.astype(np.float64)
    index = np.argwhere(filled > 0)
    fraction, normal = filled[tuple(index.T)], np.zeros(index.shape)
    # The gradient is zero among full voxels.
    within = scipy.ndimage.minimum_filter(filled, 3, mode="constant")[tuple(index.T)] >= 1
    outer = np.flatnonzero(~within)
    cubes = np.lib.stride_tricks.sliding_window_view(np.pad(filled, 1), (3, 3, 3))
    normal[outer] = -cubes[tuple(index[outer].T)].reshape(-1, 27) @ SLOPES
    length = np.linalg.norm(normal, axis=1)
    normal[length < SHEET] = 0
    normal /= np.maximum(length, SHEET)[:, None]
    if material is not None:  # It has the same voxels in the same order.
        return Voxels(index, fraction, normal, material.shift, material.spread)
    even = np.tile(np.eye(3) / 12, (len(index), 1, 1))
    return Voxels(index, fraction, normal, np.zeros(index.shape), even)
