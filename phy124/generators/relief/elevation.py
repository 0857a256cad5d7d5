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

    def meet(self, places: Field, slope: float = 0.0, axis: float = 0.0) -> Field:
        """Return the upright points [N,3] in a vertical plane at offsets [N,2] from the image's
        centre.

        In the plane, z is `slope` times the distance to the right of the column `axis` [pixels].
        """
        depth = self._depth(places, slope, axis)
        ahead = np.concatenate(
            [places * (1 - depth / self.distance)[:, None], depth[:, None]], axis=1
        )
        return ahead @ self.turn

    def stand(self, shell: Shell, slope: float = 0.0, axis: float = 0.0) -> Shell:
        """Turn a shell upright; the shell was made for a camera in front of the object.

        Each point moves along its view ray, so that the plane through the object's centre becomes
        the vertical plane that `meet` describes.
        """
        z = shell.points[:, 2]
        k = 1 - z / self.distance
        plane = self._depth(shell.points[:, :2] / k[:, None], slope, axis)
        moved = shell.points.copy()
        moved[:, :2] *= ((k - plane / self.distance) / k)[:, None]
        moved[:, 2] += plane
        lean = [-slope / np.cos(self.elevation), np.tan(self.elevation), 0.0]
        normals = shell.normals + shell.normals[:, 2:] * lean
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(shell, points=moved @ self.turn, normals=normals @ self.turn)

    def _depth(self, places: Field, slope: float, axis: float) -> Field:
        """Return the depth [N], towards the camera, at which view rays meet a vertical plane."""
        x, y = places.T
        sine, cosine = np.sin(self.elevation), np.cos(self.elevation)
        rise = sine * y - slope * x
        return -(rise + slope * axis) / (cosine - rise / self.distance)
