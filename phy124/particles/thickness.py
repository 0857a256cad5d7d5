"""Computes the local thickness of an object, which shows how many grid cells span its thin parts.

The local thickness at a point is the diameter of the largest ball that contains the point and lies
inside the object (Hildebrand and Ruegsegger 1997, J. Microscopy 185). A morphological opening by
balls of a certain diameter removes exactly the parts thinner than this diameter.
"""

from __future__ import annotations

import numpy as np
import scipy

from phy124.particles.solid import ACROSS, Solid

FRACTION = 0.25
"""Fraction of the volume that may be thinner than the reported thickness.

A tenth of the volume would be too sensitive to the voxel size, since every corner is partly thin.
"""


def relative_thickness(interior: Solid, size: float) -> float:
    """Return the local thickness of an object as a fraction of its longest side.

    Args:
        interior: The object, from `find_interior`.
        size: Longest side of the object [m].
    """
    return local_thickness(interior.resample(size / ACROSS)) / size


def local_thickness(shape: Solid, fraction: float = FRACTION) -> float:
    """Return the largest thickness [m] for which at most `fraction` of the volume is thinner.

    Parts thinner than a voxel count as one voxel thick.

    Args:
        shape: The object.
        fraction: Fraction of the volume that may be thinner.
    """
    inside = shape.fraction > 0.5 * min(1.0, shape.fraction.max())
    # The voxels around the solid do not matter; without them, distances take half the time.
    inside = np.pad(inside[scipy.ndimage.find_objects(inside.astype(np.int8))[0]], 1)
    depth = scipy.ndimage.distance_transform_edt(inside)
    radii = np.arange(1.0, depth.max() + 0.5, 0.5)
    fits, too_large = 0, len(radii)
    while too_large - fits > 1:
        middle = (fits + too_large) // 2
        core = depth >= radii[middle]
        opened = scipy.ndimage.distance_transform_edt(~core) < radii[middle]
        removed = 1 - np.count_nonzero(opened & inside) / np.count_nonzero(inside)
        fits, too_large = (middle, too_large) if removed <= fraction else (fits, middle)
    # The centres of a ball's outermost voxels are half a voxel inside the ball.
    return float((2 * radii[fits] - 1) * shape.voxel)
