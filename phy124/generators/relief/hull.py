"""The closed surface that two silhouettes at right angles, front and side, leave.

At each height the cross-section is as wide as the front picture shows and as deep as the side
picture shows, and as round as both inflated silhouettes are. Two pairs of legs give four.
Coordinates are pixels around the object's middle: x right, y down, z towards the front's viewer.
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

from phy124.generators.relief.surface import Implicit, relaxed, settled
from phy124.kernels import implicit

Field = NDArray[np.float64]
COARSE = 4
"""Cells in which the surface is looked for first, in cells of the final size."""
OUTSIDE = -4.0
"""Lowest value of a normalised silhouette, far outside it."""
ASTRAY = 0.25
"""Distance from the surface at which a point is left out, pixels."""
BEYOND = 3
"""Rows that the fields have above the object, and below it."""


@dataclass(frozen=True, eq=False)
class Hull(Implicit):
    """The zero set of F = w(x, y) + r(y)^2 (s(z, y) - 1), negative beyond flat ends.

    Here w is the squared half thickness of the front and r^2 its largest value in the row; s is the
    same of the side, divided by its largest value in the row. On a ball F = r^2 - |p|^2.
    """

    kernels: ClassVar[implicit.Kernels] = implicit.HULL
    front: Field
    """w and its slopes along x and y [H,W,3]."""
    side: Field
    """r^2 (s - 1) and its slopes along z and y [H,D,3]."""
    y: Field
    """Heights of the rows [H], evenly spaced."""
    planes: tuple[tuple[float, float, float], ...]
    """Flat ends: sign, height and steepness of each."""

    @classmethod
    def of(cls, front: Field, side: Field, y: Field, ends: tuple[bool, bool]) -> Hull:
        """From squared half thicknesses.

        Args:
            front: From the front [H,W], columns around the middle, W odd.
            side: From the side [H,D], its columns growing towards the front's viewer.
            y: Heights of their rows [H].
            ends: Whether top and bottom are flat.
        """
        thick, own = front.max(axis=1), side.max(axis=1)
        share = np.maximum(side / np.maximum(own, 1.0)[:, None] - 1, OUTSIDE)
        planes = []
        for sign, at, flat in zip((-1, 1), (BEYOND, -1 - BEYOND), ends, strict=True):
            if flat:
                planes.append((float(sign), y[at], 2 * float(np.sqrt(max(thick[at], 4.0)))))
        depth = np.maximum(thick, 1.0)[:, None] * share
        return cls(_sloped(front, y), _sloped(depth, y), y, tuple(planes))

    @cached_property
    def struct(self) -> Any:
        """What kernels read of it."""
        struct = implicit.Hull()
        struct.front = wp.array(self.front, dtype=wp.float64, device="cpu")
        struct.side = wp.array(self.side, dtype=wp.float64, device="cpu")
        struct.first, struct.pitch = float(self.y[0]), float(self.y[1] - self.y[0])
        planes = np.reshape(self.planes, (-1, 3))
        struct.planes = wp.array(planes, dtype=wp.vec3d, device="cpu")
        return struct

    def scattered(self, pitch: float, rng: np.random.Generator) -> Field:
        """Random points, on average one per pitch^2 of the surface."""
        corners = self._cells(COARSE * pitch)
        offsets = np.stack(np.meshgrid(*[np.arange(COARSE)] * 3, indexing="ij"), -1).reshape(-1, 3)
        corners = (corners[:, None] + offsets * pitch).reshape(-1, 3)
        points = corners + pitch * rng.random(corners.shape)
        # One point per cube: as many within half a pitch of the surface as it has squares.
        points = self.project(points[self._near(points, pitch / 2)], rounds=4)
        return points[self.landed(points)]

    def landed(self, points: Field) -> NDArray[np.bool_]:
        """Which points [N,3] are not astray."""
        value, gradient = self.gradient(points)
        near = np.abs(value) < ASTRAY * np.linalg.norm(gradient, axis=1)
        return near & (np.abs(points) <= self._reach()).all(axis=1)

    def _reach(self) -> Field:
        """Half of width, height and depth of the fields [3]."""
        sizes = self.front.shape[1] // 2, float(np.abs(self.y).max()), self.side.shape[1] // 2
        return np.array(sizes, dtype=np.float64)

    def _cells(self, size: float) -> Field:
        """Corners [M,3] of the cubes of a size that the surface may cross."""
        axes = [np.arange(-half, half, size) for half in self._reach()]
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return corners[self._near(corners + size / 2, 1.3 * size)]

    def _near(self, points: Field, distance: float) -> NDArray[np.bool_]:
        """Whether the surface is about so near to points [N,3]."""
        value, gradient = self.gradient(points)
        # Of r^2 - |p|^2 the distance is value / (r + |p|); far inside the gradient says too little.
        slope = np.sqrt((gradient**2).sum(axis=1) / 4 + np.abs(value))
        return np.abs(value) <= 2 * distance * slope


def _sloped(w: Field, y: Field) -> Field:
    dy, dx = np.gradient(scipy.ndimage.gaussian_filter(w, 0.7), y, np.arange(w.shape[1]))
    return np.stack([w, dx, dy], axis=2)


def spread_over(
    hull: Hull, count: int, rng: np.random.Generator, alive: Callable[[], None] = lambda: None
) -> tuple[Field, Field, Field]:
    """About `count` points [N,3] spread evenly over the hull, their normals and spacing.

    Args:
        hull: The surface.
        count: How many.
        rng: Random numbers.
        alive: Called between rounds; may raise.
    """
    trial = 3.0
    pitch = trial * float(np.sqrt(max(len(hull.scattered(trial, rng)), 1) / count))
    points = hull.scattered(pitch, rng)

    def wanted(normals: Field) -> Field:
        return np.full(len(normals), pitch)

    points = settled(hull, points, wanted, alive)
    points, spacing = relaxed(hull, points, wanted)
    landed = hull.landed(points)  # all but a handful
    points, spacing = points[landed], spacing[landed]
    return points, hull.normals(points), spacing
