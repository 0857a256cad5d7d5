"""Places eight points of equal volume that have the moments of the material in a cell."""

import numpy as np
from numpy.typing import NDArray

PER_CELL = 8
ALIGNED = 1e-7
"""Second moments count as equal if they differ by less than this [cells^2]; the points are then
aligned with the axes.
"""
CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def place_points(centre: NDArray, second: NDArray, dx: float) -> NDArray[np.float64]:
    """Return the eight points of each cell [C,8,3], m.

    Args:
        centre: Centre of the material in each cell [C,3], m.
        second: Second moments of the material about its centre, divided by its volume [C,3,3], m^2.
        dx: Side of a cell [m].
    """
    # If moments are equal, they define no axes; the points then lie along the axes of the lattice.
    _, axes = np.linalg.eigh(second + np.diag([0.0, 1.0, 2.0]) * ALIGNED * dx**2)
    # The signs of the axes are arbitrary; they are chosen so that the points of all full cells have
    # one order.
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    axes = axes * np.sign(largest)
    squares = np.einsum("cik,cij,cjk->ck", axes, second, axes)
    reach = np.sqrt(np.maximum(squares, 0))
    x: NDArray[np.float64] = centre[:, None] + np.einsum("qk,ck,cik->cqi", CORNERS, reach, axes)
    return x


def sum_groups(which: NDArray, values: NDArray, count: int) -> NDArray[np.float64]:
    """Return the sums of the rows of `values` [V,K] in each group [count,K]."""
    total = np.zeros((count, values.shape[1]))
    for number, column in enumerate(values.T):
        total[:, number] = np.bincount(which, column, count)
    return total
