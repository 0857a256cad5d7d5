"""Describes the scenery of a frame as plain data that both the renderer and the player draw."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array

Colour = tuple[float, float, float]
Box = tuple[Array, Array]
"""Lowest and highest corner of an axis-aligned box [3], m."""
TOGETHER = 64
"""Points are arranged in rows of this number of points to compute the minimum and the maximum; wide
rows are faster.
"""
POOL = 0.5
"""Brightness added in the middle of a studio's floor if the grey of the floor is 1/2."""


@dataclass(frozen=True, eq=False)
class Backdrop:
    """The background: a colour gradient or a picture."""

    top: Colour
    """Colour of the gradient in the picture's first row, 0..1."""
    bottom: Colour
    """Colour of the gradient in the picture's last row, 0..1."""
    picture: NDArray[np.uint8] | None = None
    """A picture [H,W,3] that replaces the gradient."""


@dataclass(frozen=True, eq=False)
class Floor:
    """A level floor that fades into the backdrop, and the shadow on it."""

    height: float
    """Height of the floor, m."""
    middle: tuple[float, float]
    """Centre of the square that the shadow map covers, m."""
    reach: float
    """Half the side of the square that the shadow map covers, m."""
    shade: Array
    """Fraction of the light that the shadow removes from each cell [cells along x, along y]."""
    pool: float = POOL
    """Additional brightness in the middle of the floor, if its grey is 1/2."""

    @cached_property
    def levels(self) -> NDArray[np.uint16]:
        """The values of `shade` as 16-bit integers for the kernels; 65535 means no light."""
        return (self.shade * 65535 + 0.5).astype(np.uint16)

    @cached_property
    def shaded(self) -> tuple[int, int, int, int]:
        """Indices of the first and last shaded cell of the shadow map along x, then along y."""
        along_x, along_y = (np.flatnonzero(self.shade.any(axis=axis)) for axis in (1, 0))
        if not len(along_x):
            return 0, 0, 0, 0
        return int(along_x[0]), int(along_x[-1]), int(along_y[0]), int(along_y[-1])


@dataclass(frozen=True, eq=False)
class Solid:
    """A box, or a capsule along its first axis; a ball is a capsule of length 0."""

    centre: NDArray[np.float64]
    """Centre [3], m."""
    axes: NDArray[np.float64]
    """Axes of the solid [3,3], a unit vector in each row."""
    half: NDArray[np.float64]
    """Half the sides of a box [3], m; for a capsule, half its length, 0 and 0."""
    radius: float = 0.0
    """Radius of a capsule, m; 0 for a box."""


@dataclass(frozen=True, eq=False)
class StageFrame:
    """The surroundings of the object in a frame."""

    backdrop: Backdrop
    floor: Floor | None = None
    solids: tuple[Solid, ...] = ()
    box: Box | None = None
    """A box around all Gaussians, for the drawing order of the solids; None if it is unknown."""

    @cached_property
    def table(self) -> Array:
        """The solids as an array for the kernels [S,16]."""
        table = np.empty((len(self.solids), 16), np.float32)
        for row, solid in zip(table, self.solids, strict=True):
            row[:3], row[3:12] = solid.centre, np.ravel(solid.axes)
            row[12:15], row[15] = solid.half, solid.radius
        return table


def bounds(points: Array) -> Box:
    """Return the corners of the box around points [N,3]; not finite if any point is not finite."""
    if not len(points):
        return np.full(3, np.nan, np.float32), np.full(3, np.nan, np.float32)
    even = len(points) // TOGETHER * TOGETHER
    many, rest = points[:even].reshape(-1, TOGETHER * 3), points[even:]
    ends = []
    for least in (np.minimum, np.maximum):
        extremes = [least.reduce(rest)] if len(rest) else []
        if even:
            extremes.append(least.reduce(least.reduce(many).reshape(-1, 3)))
        ends.append(least.reduce(extremes))
    return ends[0], ends[1]
