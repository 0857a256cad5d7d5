"""Finds Gaussians outside the surface points of a body, which touch walls like surface points.

The surface of a solid is a mean of the Gaussians around it. Where Gaussians are sparse, some lie
outside this surface by a large part of a cell. Without contact, these Gaussians would sink into
walls by the same distance.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.solid import Solid

ABOVE = 0.15
"""A Gaussian is a protrusion if it is higher above the nearest surface point than this [cells]."""
ASIDE = 0.45
"""A Gaussian outside the solid is a protrusion if it is farther from all surface points than this
[cells].
"""
STRAY = 1.5
"""Gaussians that are farther from all surface points than this have no contact [cells]."""


def find_protrusions(solid: Solid, surface: NDArray, dx: float) -> NDArray[Any]:
    """Return the positions of protrusions [m], and the normals of the nearest surface points [K,6].

    Args:
        solid: The solid; without Gaussians, there are no protrusions.
        surface: Surface points [m], and outward normals [S,6].
        dx: Side of a cell [m].
    """
    if solid.means is None or not len(surface):
        return np.zeros((0, 6))
    distance, near = scipy.spatial.KDTree(surface[:, :3]).query(
        solid.means, distance_upper_bound=STRAY * dx
    )
    some = np.flatnonzero(np.isfinite(distance))
    nearest = surface[np.asarray(near)[some]]
    x, distance = solid.means[some], np.asarray(distance)[some]
    normal = nearest[:, 3:]
    height = ((x - nearest[:, :3]) * normal).sum(axis=1)
    outside = height > ABOVE * dx
    aside = np.flatnonzero((distance > ASIDE * dx) & (height > -ABOVE * dx))
    outside[aside] |= ~solid.contains(x[aside])
    return np.concatenate([x, normal], axis=1)[outside]
