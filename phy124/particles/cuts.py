"""Exact volumes and moments of the part of a cube between two parallel planes.

The part of a cube below a plane is a sum, with alternating signs, over tetrahedra at the corners of
the cube, so its moments are known in closed form. Lengths are relative to a voxel, and positions
are relative to the middle of the cube.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

FLAT = 3e-3
"""Smallest component of a normal; the sum of volumes loses precision near zero."""
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5
"""Corners of a cube of side 1, relative to its middle [8,3]."""
SIGNS = np.prod(-2 * CORNERS, axis=1)
BLOCK = 4000
"""Number of voxels that `moments_below` processes at a time; all their numbers fit in a cache."""


def below(normal: NDArray, height: NDArray, side: float = 1) -> NDArray[np.float64]:
    """Return the volume of a cube below a plane [K].

    Args:
        normal: Unit normals of the planes [K,3].
        height: Distances of the planes from the middles of the cubes, along the normals [K].
        side: Side of the cubes.
    """
    size, depth = _depths(normal, height, side)
    result: NDArray[np.float64] = SIGNS @ depth**3 / 6 / size.prod(axis=0)
    return result


def between(
    normal: NDArray, height: NDArray, thick: NDArray, side: float = 1
) -> NDArray[np.float64]:
    """Return the volume [K] of a cube between two parallel planes.

    Args:
        normal: Unit normals of the planes [K,3].
        height: Distance from the middle of each cube to the point midway between its two planes
            [K].
        thick: Distances between the planes [K].
        side: Side of the cubes.
    """
    upper, lower = (below(normal, height + part * thick, side) for part in (0.5, -0.5))
    return upper - lower


def moments_below(
    normal: NDArray, height: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the volume [K], first moments [K,3] and second moments [K,3,3] of the part of each
    voxel below a plane, about the middle of the voxel.
    """
    blocks = [slice(start, start + BLOCK) for start in range(0, len(normal) or 1, BLOCK)]
    volume, first, second = zip(*(_moments(normal[b], height[b]) for b in blocks), strict=True)
    return np.concatenate(volume), np.concatenate(first), np.concatenate(second)


def _moments(
    normal: NDArray, height: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    size, depth = _depths(normal, height, 1)
    flip = np.where(normal < 0, -1.0, 1.0).T
    weight = SIGNS[:, None] * depth**3 / (6 * size.prod(axis=0))
    # Edges and centres of the tetrahedra at the corners, for each axis [8,K].
    edge = [depth / each for each in size]
    mean = [CORNERS[:, axis, None] + edge[axis] / 4 for axis in range(3)]
    first = np.stack([(weight * mean[i]).sum(axis=0) * flip[i] for i in range(3)], axis=1)
    second = np.empty((len(normal), 3, 3))
    for i, j in itertools.combinations_with_replacement(range(3), 2):
        inner = edge[i] * edge[j] * (3 / 80 if i == j else -1 / 80)
        moment = (weight * (inner + mean[i] * mean[j])).sum(axis=0)
        second[:, i, j] = second[:, j, i] = moment * flip[i] * flip[j]
    return weight.sum(axis=0), first, second


def _depths(
    normal: NDArray, height: NDArray, side: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the absolute values of the normals' components [3,K], and the depths of the cubes'
    corners below the planes [8,K].

    A plane beyond a cube is moved to the nearest corner, because the sums over corners lose all
    digits far from the cube.
    """
    size = np.maximum(np.abs(normal), FLAT).T
    reach = side * size.sum(axis=0) / 2
    return size, np.maximum(np.clip(height, -reach, reach) - side * (CORNERS @ size), 0)
