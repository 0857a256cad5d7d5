"""Keeps wide Gaussians at the edges of an object from changing the size of the object.

Flat Gaussians near an edge extend beyond the edge, all the more if they are few and wide. The scale
of an object follows from the extent of its Gaussians, so the solid would become smaller.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.particles.cleaning import compute_bounds, weighted_quantile
from phy124.particles.surface import shortest_axes

OUTERMOST = 0.001
"""Fraction of the opacity that is excluded at each end, as in `compute_bounds`."""
TINY = 1e-9


def keep_extent(gaussians: Gaussians, before: Gaussians, reach: NDArray) -> Gaussians:
    """Move enlarged Gaussians inwards so that the object keeps its size.

    Args:
        gaussians: The enlarged Gaussians.
        before: All Gaussians of the object, which determine its size.
        reach: Standard deviations along the world axes that the N Gaussians had before [N,3], m.
    """
    return _move_inwards(gaussians, *compute_bounds(before), reach)


def limit_to_surface(gaussians: Gaussians, depth: float = 0.0) -> Gaussians:
    """Move flat Gaussians inwards so that they do not extend beyond the ends of their surface.

    `depth` is the distance of the centres below the surface [m].
    """
    low = weighted_quantile(gaussians.means, gaussians.opacities, OUTERMOST) - depth
    high = -weighted_quantile(-gaussians.means, gaussians.opacities, OUTERMOST) + depth
    thickness = np.abs(shortest_axes(gaussians)) * gaussians.scales.min(axis=1, keepdims=True)
    return _move_inwards(gaussians, low, high, thickness)


def _move_inwards(gaussians: Gaussians, low: NDArray, high: NDArray, reach: NDArray) -> Gaussians:
    """Move Gaussians that extend beyond a box and also farther than `reach` [N,3] from their
    centres; flat Gaussians stay in their planes.
    """
    means, now = gaussians.means.astype(np.float64), gaussians.deviations()
    down = np.minimum(np.maximum(high, means + reach) - (means + now), 0)
    up = np.maximum(np.minimum(low, means - reach) - (means - now), 0)
    normals = shortest_axes(gaussians).astype(np.float64)
    for axis, inwards in enumerate((down + up).T):
        # The component of the axis in the plane; its square is the component along the axis.
        along = np.eye(3)[axis] - normals[:, axis : axis + 1] * normals
        means += along * (inwards / np.maximum(along[:, axis], TINY))[:, None]
    return replace(gaussians, means=means)
