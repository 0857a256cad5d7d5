"""A pinhole camera with pixel centres at half-integers, and the four views of the Phy124 paper.

The axes are OpenCV's: x right, y down, z forward. Pixel (i, j) covers [i, i+1) x [j, j+1). The
optical axis meets the image at (width/2, height/2) unless it is shifted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

VIEWS = {"front": 0.0, "right": 90.0, "back": 180.0, "left": 270.0}
"""Azimuths of the four views in the Phy124 paper [degrees]; front is +x, right is +y."""
FOV_Y = 49.1
"""Default vertical field of view [degrees], as in LGM."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at `eye` that looks at `target`; world z points up in the image."""

    eye: tuple[float, float, float]
    """Position, m."""
    target: tuple[float, float, float]
    """Point in the middle of the image, m."""
    width: int
    """Image width, pixels."""
    height: int
    """Image height, pixels."""
    fov_y: float = FOV_Y
    """Vertical field of view, degrees."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Offset of the principal point to the right and downwards, pixels."""

    @classmethod
    def orbit(
        cls,
        azimuth: float,
        elevation: float,
        radius: float,
        size: int | tuple[int, int],
        target: tuple[float, float, float] = (0.0, 0.0, 0.0),
        fov_y: float = FOV_Y,
    ) -> Camera:
        """Return a camera on a sphere around `target`.

        Args:
            azimuth: Azimuth, degrees. 0 is the front (+x), 90 the right side (+y).
            elevation: Elevation, degrees; if positive, the camera looks down.
            radius: Distance from the target, m.
            size: Width and height in pixels, or one number for both.
            target: Point to look at [3], m.
            fov_y: Vertical field of view, degrees.
        """
        a, e = math.radians(azimuth), math.radians(elevation)
        away = (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))
        x, y, z = (t + radius * d for t, d in zip(target, away, strict=True))
        width, height = (size, size) if isinstance(size, int) else size
        return cls((x, y, z), target, width, height, fov_y)

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.height / math.tan(0.5 * math.radians(self.fov_y))

    @property
    def halves(self) -> tuple[float, float]:
        """Half the width and height of the visible area at a distance of 1."""
        return 0.5 * self.width / self.focal, 0.5 * self.height / self.focal

    @property
    def centre(self) -> tuple[float, float]:
        """Point at which the optical axis meets the image, pixels."""
        return self.width / 2 + self.shift[0], self.height / 2 + self.shift[1]

    @cached_property
    def view(self) -> NDArray[np.float64]:
        """Transform from world to camera coordinates [4,4]."""
        eye, target = np.asarray(self.eye, float), np.asarray(self.target, float)
        forward = (target - eye) / np.linalg.norm(target - eye)
        # If a camera looks straight up or down, +x is at the top of the image.
        up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1 - 1e-9 else np.array([1.0, 0.0, 0.0])
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3, :3] = right, np.cross(forward, right), forward
        matrix[:3, 3] = -matrix[:3, :3] @ eye
        return matrix

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """Matrix from camera to pixel coordinates [3,3]."""
        f = self.focal
        x, y = self.centre
        return np.array([[f, 0, x], [0, f, y], [0, 0, 1]])

    def project(self, points: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return pixel positions [N,2] and depths [N] m of world points [N,3]."""
        seen = points @ self.view[:3, :3].T + self.view[:3, 3]
        image = seen @ self.intrinsics.T
        return image[:, :2] / image[:, 2:], seen[:, 2]
