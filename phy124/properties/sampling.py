"""Values between points: those of the nearest point, or trilinear between voxels."""

from __future__ import annotations

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
    """The values of the nearest points.

    Args:
        x: Positions [P,3].
        points: Points [K,3].
        columns: Name -> value of each point [K].

    Returns:
        Name -> value at each position [P].
    """
    at = scipy.spatial.KDTree(points).query(x)[1]
    return {name: column[at] for name, column in columns.items()}


def trilinear(
    x: NDArray, points: NDArray, columns: dict[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Values interpolated between the centres of voxels.

    Empty voxels are ignored. A position with no full voxel next to it gets the value of the nearest
    one, and so does every name of a law.

    Args:
        x: Positions [P,3].
        points: Centres of the voxels [K,3].
        columns: Name -> value of each voxel [K].

    Returns:
        Name -> value at each position [P].

    Raises:
        InputError: The points are not on a regular grid.
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
            # Counted from the smallest value, so that equal values are reproduced exactly.
            values[name] = np.where(
                near, column.min() + total / np.maximum(weight, 1e-6), values[name]
            )
    return values


def _between(values: NDArray, index: NDArray, shape: tuple[int, ...], at: NDArray) -> NDArray:
    grid = np.zeros(shape)
    grid[tuple(index.T)] = values
    return scipy.ndimage.map_coordinates(grid, at, order=1, mode="nearest")


def _lattice(points: NDArray) -> tuple[NDArray[np.int_], NDArray[np.float64], NDArray[np.float64]]:
    """Index of each point [K,3], spacing [3] and first centre [3] of the grid they are on."""
    low = points.min(axis=0)
    spacing = np.array([_step(points[:, axis]) for axis in range(3)])
    index = np.rint((points - low) / spacing).astype(int)
    if np.abs((points - low) / spacing - index).max() > REGULAR or index.max() >= FINEST:
        raise InputError(
            "properties.sampling",
            "trilinear",
            "the file's points lie on no regular grid.",
            "Use nearest.",
        )
    return index, spacing, low


def _step(along: NDArray) -> float:
    """The usual distance between neighbouring centres along an axis."""
    apart = np.diff(np.unique(along))
    apart = apart[apart > 1e-4 * max(np.ptp(along), 1e-12)]
    return float(np.median(apart)) if len(apart) else 1.0
