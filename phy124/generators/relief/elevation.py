"""Turns an object upright if the camera was raised.

Upright coordinates are pixels: x right, y down, z horizontally towards the camera. The points do
not move in the camera's image.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.shell import Shell

Field = NDArray[np.float64]


@dataclass(frozen=True)
class Raised:
    """A camera that looks down on the object's centre."""

    elevation: float
    """Angle of the camera above the horizontal [radians]."""
    distance: float
    """Distance of the camera from the object's centre [pixels]."""

    @cached_property
    def turn(self) -> Field:
        """Rotation from upright coordinates to the camera's [3,3]."""
        sine, cosine = np.sin(self.elevation), np.cos(self.elevation)
        return np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])

    def pixels(self, points: Field) -> Field:
        """Project upright points [N,3]; return offsets [N,2] from the image's centre."""
        seen = points @ self.turn.T
        return seen[:, :2] / (1 - seen[:, 2:] / self.distance)

    def stand(self, shell: Shell) -> Shell:
        """Turn a shell upright; the shell was made for a camera in front of the object.

        Each point moves along its view ray, so that the plane through the object's centre becomes
        vertical.
        """
        x, y, z = shell.points.T
        k = 1 - z / self.distance
        tangent = np.tan(self.elevation)
        # The vertical plane through the centre meets the view ray of the point at this z.
        plane = -y * tangent / (k - y * tangent / self.distance)
        moved = np.stack([x, y, z], axis=1)
        moved[:, :2] *= ((k - plane / self.distance) / k)[:, None]
        moved[:, 2] += plane
        normals = shell.normals + shell.normals[:, 2:] * [0.0, tangent, 0.0]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(shell, points=moved @ self.turn, normals=normals @ self.turn)
