"""Computes contact distances of points that touch a surface at the start."""

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.lattice.start import CLOSE, FACING, INSIDE, NEAR, PARALLEL


def initial_gaps(
    gap: NDArray[np.float64], n: NDArray[np.float64], normal: NDArray[np.float64], dx: float
) -> NDArray[np.float64]:
    """Return the distances from a surface at which contact of points begins [K], m.

    The distance is -inf for points that do not touch the surface from outside at the start.

    Args:
        gap: Distances of the points from the surface at the start [K], m.
        n: Normals of the surface at the points [K,3].
        normal: Outward normals at the points [K,3]; zero on sheets.
        dx: Side of a cell [m].
    """
    cosine = np.where(normal.any(axis=1), -(n * normal).sum(axis=1), 1.0)
    reach = np.select([cosine >= PARALLEL, cosine >= FACING], [NEAR, CLOSE], 0.0) * dx
    return np.where((gap > 0) & (gap < reach), gap + INSIDE * dx, -np.inf)
