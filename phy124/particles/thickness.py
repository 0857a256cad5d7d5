"""The local thickness of an object: how many cells of a grid lie across its thin parts.

The local thickness at a point is the diameter of the largest ball inside the object that contains
the point (Hildebrand and Ruegsegger 1997, J. Microscopy 185). An opening by balls of some diameter
removes all that is thinner.
"""

from __future__ import annotations

import numpy as np
import scipy

from phy124.gaussians import Gaussians
from phy124.particles.solid import ACROSS, Solid, find_solid

FRACTION = 0.25
"""Fraction of the volume whose thickness counts.

The value for a tenth of the volume depends on the voxels, since a part of any corner is thin.
"""


def relative_thickness(gaussians: Gaussians, size: float) -> float:
    """Return the local thickness of an object as a fraction of its size.

    Args:
        gaussians: The clean object.
        size: Its longest side [m].
    """
    return local_thickness(find_solid(gaussians, size / ACROSS)) / size


def local_thickness(shape: Solid, fraction: float = FRACTION) -> float:
    """Return the largest thickness that a fraction of the volume does not exceed [m].

    Parts thinner than a voxel count as one voxel thick.

    Args:
        shape: The object.
        fraction: Fraction of the volume.
    """
    inside = np.pad(shape.fraction > 0.5 * min(1.0, shape.fraction.max()), 1)
    depth = scipy.ndimage.distance_transform_edt(inside)
    radii = np.arange(1.0, depth.max() + 0.5, 0.5)
    fits, too_large = 0, len(radii)
    while too_large - fits > 1:
        middle = (fits + too_large) // 2
        core = depth >= radii[middle]
        opened = scipy.ndimage.distance_transform_edt(~core) < radii[middle]
        removed = 1 - np.count_nonzero(opened & inside) / np.count_nonzero(inside)
        fits, too_large = (middle, too_large) if removed <= fraction else (fits, middle)
    # The centres of the outermost voxels of a ball are half a voxel inside it.
    return float((2 * radii[fits] - 1) * shape.voxel)
