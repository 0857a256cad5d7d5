"""Evaluates values at new positions: from the nearest point, or by interpolation."""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError

REGULAR = 0.05
"""Largest distance of a point from the centre of its voxel [voxels]."""
FINEST = 512
"""Largest number of voxels along an axis."""


def nearest(
    x: NDArray, points: NDArray, columns: dict[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Return the values [P] of the point [K,3] that is nearest to each position [P,3]."""
    at = scipy.spatial.KDTree(points).query(x)[1]
    return {name: column[at] for name, column in columns.items()}


def trilinear(
    x: NDArray, points: NDArray, columns: dict[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Interpolate values trilinearly between the centres of voxels.

    Names of laws, and all values far from any full voxel, are taken from the nearest full voxel.

    Args:
        x: Positions [P,3].
        points: Centres of the voxels [K,3].
        columns: One value per voxel [K], keyed by column name.

    Returns:
        One value per position [P], keyed by column name.

    Raises:
        InputError: If the points do not form a regular grid.
    """
    index, spacing, low = _lattice(points)
    shape = tuple(index.max(axis=0) + 1)
    at = ((x - low) / spacing).T
    weight = _between(np.ones(len(points)), index, shape, at)
    values = nearest(x, points, columns)
    near = weight > 1e-6
    for name, column in columns.items():
        if name != "law":
            total = _between(column - column.min(), index, shape, at)
            # If differences from the smallest value are interpolated, equal values are reproduced
            # exactly.
            values[name] = np.where(
                near, column.min() + total / np.maximum(weight, 1e-6), values[name]
            )
    return values


def _between(values: NDArray, index: NDArray, shape: tuple[int, ...], at: NDArray) -> NDArray:
    grid = np.zeros(shape)
    grid[tuple(index.T)] = values
    return scipy.ndimage.map_coordinates(grid, at, order=1, mode="nearest")


def _lattice(points: NDArray) -> tuple[NDArray[np.int_], NDArray[np.float64], NDArray[np.float64]]:
    """Return the grid indices [K,3], the spacing [3] and the first voxel's centre [3]."""
    low = points.min(axis=0)
    spacing = np.array([_step(points[:, axis]) for axis in range(3)])
    index = np.rint((points - low) / spacing).astype(int)
    if np.abs((points - low) / spacing - index).max() > REGULAR or index.max() >= FINEST:
        raise InputError(
            "properties.sampling",
            "trilinear",
            "the file's points do not form a regular grid.",
            "Use nearest.",
        )
    return index, spacing, low


def _step(along: NDArray) -> float:
    apart = np.diff(np.unique(along))
    apart = apart[apart > 1e-4 * max(np.ptp(along), 1e-12)]
    return float(np.median(apart)) if len(apart) else 1.0
