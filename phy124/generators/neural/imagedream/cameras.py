"""The camera poses given to ImageDream, one per view, in Blender's axes (z up)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.generators.neural.orbit import orbit

AZIMUTHS = (0, 90, 180, 270)
"""Azimuths of the four views, degrees."""


def cameras(elevation: float = 0.0) -> NDArray[np.float32]:
    """Camera to world of the four views, and zeros for the picture itself [5,16], row by row.

    A positive elevation [degrees] is below the object, as in all of these networks.
    """
    rows = [pose_row(elevation, azimuth) for azimuth in AZIMUTHS]
    return np.array([*rows, [0.0] * 16], dtype=np.float32)


def pose_row(elevation: float, azimuth: float) -> list[float]:
    """Camera-to-world transform of one view at distance 1, 16 numbers; y up becomes z up."""
    pose = orbit(elevation, azimuth, 1.0)[[0, 2, 1, 3]]
    return (pose * np.array([1.0, -1.0, 1.0, 1.0])[:, None]).reshape(16).tolist()
