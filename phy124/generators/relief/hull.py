"""Builds the closed surface that matches two silhouettes, from the front and from the side.

The front determines the width of each cross-section, and the side determines the depth. Coordinates
are pixels relative to the object's centre: x right, y down, z towards the front camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.generators.relief.surface import WIDEST, Implicit, relax, settle, thin_out
from phy124.kernels import implicit

Field = NDArray[np.float64]
COARSE = 4
"""Cell size of the coarse search, relative to the final search."""
TRIAL = 3.0
"""Spacing of the random points that measure the hull's area [pixels]."""
OUTSIDE = -4.0
"""Lower limit of s - 1 far outside the object (see `Hull`)."""
TOLERANCE = 0.25
"""Largest distance of a point from the surface [pixels]."""
BEYOND = 3
"""Number of extra rows above and below the object."""


@dataclass(frozen=True, eq=False)
class Hull(Implicit):
    """The zero set of F = w(x, y) + r(y)^2 (s(z, y) - 1), cut off at flat ends.

    Here w is the squared half thickness from the front, and r^2 is the largest w of the row. s is
    the squared half thickness from the side, divided by its largest value in the row. For a ball, F
    = r^2 - |p|^2.
    """

    kernels: ClassVar[implicit.Kernels] = implicit.HULL
    front: Field
    """The field w, and derivatives along x and y [H,W,3]."""
    side: Field
    """The field r^2 (s - 1), and derivatives along z and y [H,D,3]."""
    y: Field
    """Evenly spaced heights of the rows [H]."""
    planes: tuple[tuple[float, float, float], ...]
    """Sign, height and steepness of each flat end."""

    @classmethod
    def of(cls, front: Field, side: Field, y: Field, ends: tuple[bool, bool]) -> Hull:
        """Build the hull from the squared half thicknesses of two silhouettes.

        Args:
            front: Squared half thicknesses [H,W]; W is odd, and the object is centred.
            side: Squared half thicknesses [H,D]; columns go towards the front camera.
            y: Heights of the rows [H].
            ends: Whether the top is flat, and whether the bottom is flat.
        """
        thick, largest = front.max(axis=1), side.max(axis=1)
        share = np.maximum(side / np.maximum(largest, 1.0)[:, None] - 1, OUTSIDE)
        planes = []
        for sign, at, flat in zip((-1, 1), (BEYOND, -1 - BEYOND), ends, strict=True):
            if flat:
                planes.append((float(sign), y[at], 2 * float(np.sqrt(max(thick[at], 4.0)))))
        depth = np.maximum(thick, 1.0)[:, None] * share
        return cls(_add_slopes(front, y), _add_slopes(depth, y), y, tuple(planes))

    @cached_property
    def struct(self) -> Any:
        """The fields as a Warp struct."""
        struct = implicit.Hull()
        struct.front = wp.array(self.front, dtype=wp.float64, device="cpu")
        struct.side = wp.array(self.side, dtype=wp.float64, device="cpu")
        struct.first, struct.pitch = float(self.y[0]), float(self.y[1] - self.y[0])
        planes = np.reshape(self.planes, (-1, 3))
        struct.planes = wp.array(planes, dtype=wp.vec3d, device="cpu")
        return struct

    def scatter(self, pitch: float, rng: np.random.Generator) -> Field:
        """Return random points near the surface, on average one per area pitch^2."""
        corners = self._cells(COARSE * pitch)
        offsets = np.stack(np.meshgrid(*[np.arange(COARSE)] * 3, indexing="ij"), -1).reshape(-1, 3)
        corners = (corners[:, None] + offsets * pitch).reshape(-1, 3)
        points = corners + pitch * rng.random(corners.shape)
        # With one random point per cube, there is one point within half a pitch of the surface per
        # pitch^2 of its area.
        points = self.project(points[self._near(points, pitch / 2)], rounds=4)
        return points[self.is_near(points)]

    def is_near(self, points: Field) -> NDArray[np.bool_]:
        """Whether each point [N,3] is within `TOLERANCE` of the surface."""
        value, gradient = self.gradient(points)
        near = np.abs(value) < TOLERANCE * np.linalg.norm(gradient, axis=1)
        return near & (np.abs(points) <= self._reach()).all(axis=1)

    def _reach(self) -> Field:
        """Return half the width, height and depth [3] of the fields."""
        sizes = self.front.shape[1] // 2, float(np.abs(self.y).max()), self.side.shape[1] // 2
        return np.array(sizes, dtype=np.float64)

    def _cells(self, size: float) -> Field:
        axes = [np.arange(-half, half, size) for half in self._reach()]
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return corners[self._near(corners + size / 2, 1.3 * size)]

    def _near(self, points: Field, distance: float) -> NDArray[np.bool_]:
        value, gradient = self.gradient(points)
        # If the field is r^2 - |p|^2, the distance is value / (r + |p|). Deep inside the object,
        # dividing by the norm of the gradient alone would be inaccurate.
        slope = np.sqrt((gradient**2).sum(axis=1) / 4 + np.abs(value))
        return np.abs(value) <= 2 * distance * slope


def _add_slopes(w: Field, y: Field) -> Field:
    dy, dx = np.gradient(scipy.ndimage.gaussian_filter(w, 0.7), y, np.arange(w.shape[1]))
    return np.stack([w, dx, dy], axis=2)


def spread_over(
    hull: Hull, count: int, rng: np.random.Generator, alive: Callable[[], None] = lambda: None
) -> tuple[Field, Field, Field]:
    """Distribute points [N,3] evenly on the hull; also return normals and spacing.

    Args:
        hull: The surface on which the points are placed.
        count: Approximate number of points.
        rng: Random number generator.
        alive: Called between rounds; may raise an exception to cancel.
    """
    trial = hull.scatter(TRIAL, rng)
    pitch = TRIAL * float(np.sqrt(max(len(trial), 1) / count))
    few, part = pitch > WIDEST, (TRIAL / pitch) ** 2
    points = thin_out(trial, part, rng) if few else hull.scatter(pitch, rng)

    def spacing_at(normals: Field) -> Field:
        return np.full(len(normals), pitch)

    points = settle(hull, points, spacing_at, alive)
    points, spacing = relax(hull, points, spacing_at)
    is_near = hull.is_near(points)  # almost all points are near the surface
    points, spacing = points[is_near], spacing[is_near]
    return points, hull.normals(points), spacing
