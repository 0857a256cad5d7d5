"""Finds the surface points that touch a surface at the start, and their distances from it.

The surfaces of bodies are known to within one cell only, so surfaces that should touch may start at
some distance. If a surface holds points, it also holds these points, at their initial distances.
"""

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.lattice.grid import INSIDE, PARALLEL

NEAR = 0.75
"""Largest initial distance of a point that touches a surface [cells]. The surfaces of two boxes of
48 cells that stand side by side are up to 0.64 cells apart.
"""


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
    parallel = ~normal.any(axis=1) | ((n * normal).sum(axis=1) < -PARALLEL)
    touches = (gap > 0) & (gap < NEAR * dx) & parallel
    return np.where(touches, gap + INSIDE * dx, -np.inf)
