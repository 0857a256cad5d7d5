"""The front camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
VIEW_DISTANCE = 2.0
"""Distance of the front camera that sees exactly the picture, in longest sides."""


@dataclass(frozen=True)
class View:
    """The perspective of the front camera: it sees each point over its pixel.

    x' = x k(z), y' = y k(z) around the middle, with k = 1 - z / distance.
    """

    middle: Field
    """Pixel that the camera looks at [3], z = 0."""
    distance: float
    """Distance of the camera, pixels."""

    @classmethod
    def of(cls, own: NDArray[np.bool_], distance: float) -> View:
        """The camera that looks at the middle of the object's pixels [H,W]."""
        y, x = np.nonzero(own)
        return cls(np.array([x.min() + x.max(), y.min() + y.max(), 0.0]) / 2, distance)

    def k(self, z: Field) -> Field:
        """Scale factor at depth z."""
        return 1 - z / self.distance

    def drawn(self, points: Field, normals: Field) -> tuple[Field, Field]:
        """Points [N,3] relative to the middle, and unit normals, both contracted."""
        flat, z = (points - self.middle)[:, :2], points[:, 2:]
        k = self.k(z)
        across = normals[:, :2] / k
        along = normals[:, 2:] + (flat * across).sum(axis=1, keepdims=True) / self.distance
        turned = np.concatenate([across, along], axis=1)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return np.concatenate([flat * k, z], axis=1), turned

    def undrawn(self, points: Field) -> Field:
        """The pixels [N,3] of contracted points [N,3]."""
        flat, z = points[:, :2], points[:, 2:]
        return np.concatenate([flat / self.k(z), z], axis=1) + self.middle
