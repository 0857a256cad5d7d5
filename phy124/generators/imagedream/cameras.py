"""What ImageDream is told of its cameras: the pose of each view, in Blender's axes (z up)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.generators.orbit import orbit

AZIMUTHS = (0, 90, 180, 270)
"""Of the four views, degrees."""


def cameras(elevation: float = 0.0) -> NDArray[np.float32]:
    """Camera to world of the four views and zeros for the picture itself [5,16], row by row.

    A positive elevation [degrees] is below the object, as everywhere in these networks.
    """
    poses = [_to_blender(orbit(elevation, azimuth, 1.0)).reshape(16) for azimuth in AZIMUTHS]
    return np.stack([*poses, np.zeros(16)]).astype(np.float32)


def _to_blender(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """World y up to z up: (x, y, z) -> (x, -z, y)."""
    return pose[[0, 2, 1, 3]] * np.array([1.0, -1.0, 1.0, 1.0])[:, None]
