"""Cameras of the generative networks: OpenGL axes with y up, and the object's front at +z.

A camera with *positive* elevation is *below* the object, unlike in `phy124.camera`. A camera with
an azimuth of 90 degrees looks at the object's left side (+x).
"""

import math

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.io.axes import rotate_gaussians

FOV_Y = 49.1
"""Vertical field of view of all networks [degrees]."""
TO_WORLD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation from the networks' axes to those of phy124 (z up, front +x)."""


def orbit(elevation: float, azimuth: float, radius: float) -> NDArray[np.float64]:
    """Return a camera-to-world transform [4,4] with the columns right, up, back and position.

    The angles are in degrees.
    """
    e, a = math.radians(elevation), math.radians(azimuth)
    back = np.array([math.cos(e) * math.sin(a), -math.sin(e), math.cos(e) * math.cos(a)])
    # `right` depends only on the azimuth, so it is also defined for a camera straight above or
    # below the object.
    right = np.array([math.cos(a), 0.0, -math.sin(a)])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    matrix[:3, 3] = radius * back
    return matrix


def to_opencv(camera_to_world: NDArray) -> NDArray[np.float64]:
    """Convert an OpenGL camera-to-world transform to world-to-camera [4,4]; x right, y down, z
    forward.
    """
    return np.linalg.inv(camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0]))


def focal(height: int, fov_y: float = FOV_Y) -> float:
    """Return the focal length of an image [pixels]."""
    return 0.5 * height / math.tan(0.5 * math.radians(fov_y))


def to_world(gaussians: Gaussians) -> Gaussians:
    """Rotate Gaussians from the networks' axes (y up, front +z) to phy124's (z up, front +x)."""
    return rotate_gaussians(gaussians, TO_WORLD)
