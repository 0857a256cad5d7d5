"""The cameras given to LGM: Pluecker coordinates of each pixel's ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.generators.neural.orbit import FOV_Y, focal, orbit

RADIUS = 1.5
"""Distance of the four cameras from the origin."""
AZIMUTHS = (0, 90, 180, 270)
"""Azimuths of the views, degrees: the front, then counter-clockwise seen from above."""


def pluecker(camera_to_world: NDArray, size: int, fov_y: float = FOV_Y) -> NDArray[np.float32]:
    """Ray of every pixel [6,S,S]: moment o x d, then the unit direction d.

    `camera_to_world` is [4,4] in OpenGL axes; pixel centres lie at half integers.
    """
    f = focal(size, fov_y)
    x = (np.arange(size) - size / 2 + 0.5) / f
    right, up = np.meshgrid(x, -x)
    directions = np.stack([right, up, np.full_like(right, -1)], axis=-1) @ camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    moments = np.cross(np.broadcast_to(camera_to_world[:3, 3], directions.shape), directions)
    rays = np.concatenate([moments, directions], axis=-1)
    return rays.transpose(2, 0, 1).astype(np.float32)


def four_rays(size: int, *, elevation: float = 0.0) -> NDArray[np.float32]:
    """Rays of LGM's four views [4,6,S,S]; a positive elevation [degrees] looks from below."""
    return np.stack([pluecker(orbit(elevation, a, RADIUS), size) for a in AZIMUTHS])
