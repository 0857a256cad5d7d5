"""Colours of an object that is known from several sides: each picture where it shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Field = NDArray[np.float64]
FACING = 4.0
"""How decidedly the picture counts that faces the surface most: a power of the cosine."""
HIDDEN = 0.02
"""Weight of a picture that shows something in front of the point instead."""
BEHIND = 8.0
"""How far behind what is seen a point is hidden, pixels."""
CELL = 2.0
"""Edge of the cells in which points hide each other, pixels."""


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of the object from one side."""

    rgb: Field
    """Colours [H,W,3], continued beyond the silhouette."""
    middle: tuple[float, float]
    """Column and row of the object's middle."""
    towards: Field
    """Unit vector towards its camera [3]."""
    across: Field
    """Unit vector along its rows [3]."""
    weight: float = 1.0
    """How much it counts, relative to a picture."""

    def colours(self, points: Field, distance: float) -> Field:
        """Colours [N,3] where a camera at a distance from the middle sees points [N,3]."""
        column, row = self._places(points, distance)
        place = np.stack([row + self.middle[1], column + self.middle[0]])
        channels = [
            scipy.ndimage.map_coordinates(self.rgb[..., c], place, order=1, mode="nearest")
            for c in range(3)
        ]
        return np.stack(channels, axis=1)

    def weights(self, points: Field, normals: Field, distance: float) -> Field:
        """How well each point is seen [N]."""
        facing = np.maximum(normals @ self.towards, 0.0) ** FACING
        return self.weight * facing * np.where(self._seen(points, distance), 1.0, HIDDEN) + 1e-6

    def _seen(self, points: Field, distance: float) -> NDArray[np.bool_]:
        cells = np.floor(self._places(points, distance) / CELL).astype(int)
        cells -= cells.min(axis=1, keepdims=True)
        nearest = np.full(cells.max(axis=1) + 1, -np.inf)
        along = points @ self.towards
        np.maximum.at(nearest, tuple(cells), along)
        return along > nearest[tuple(cells)] - BEHIND

    def _places(self, points: Field, distance: float) -> Field:
        """Column and row [2,N] relative to the middle."""
        near = 1 - points @ self.towards / distance
        return np.stack([points @ self.across, points[:, 1]]) / near


def blended(points: Field, normals: Field, pictures: Sequence[Shown], distance: float) -> Field:
    """Colours [N,3] of points from the pictures that show them.

    Args:
        points: Around the object's middle [N,3], pixels.
        normals: Of the surface there [N,3].
        pictures: What the object looks like.
        distance: Of every camera, pixels.
    """
    weights = np.stack([picture.weights(points, normals, distance) for picture in pictures])
    weights /= weights.sum(axis=0)
    colours = np.stack([picture.colours(points, distance) for picture in pictures])
    return np.einsum("vn,vnc->nc", weights, colours)
