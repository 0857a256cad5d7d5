"""Describes tables, stools and chairs: a top on three or four legs, perhaps with a backrest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.boards import Board
from phy124.generators.relief.elevation import Raised

Field = NDArray[np.float64]


def _circle(corners: int) -> Field:
    angles = 2 * np.pi * np.arange(corners) / corners
    return np.stack([np.sin(angles), np.cos(angles)], axis=1)


SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
"""Corners of a rectangle, relative to half the sides; the second column points to the front."""


class Kind(NamedTuple):
    """Shape of the top, positions of the legs, and whether there is a backrest."""

    top: Field
    """Corners of the top, relative to half the width and half the depth [C,2]."""
    legs: Field
    """Places of the legs [L,2]."""
    backed: bool


SQUARE_TABLE, CHAIR = Kind(SQUARE, SQUARE, False), Kind(SQUARE, SQUARE, True)
ROUND_TABLES = Kind(_circle(24), _circle(4), False), Kind(_circle(24), _circle(3), False)


class Sizes(NamedTuple):
    """Sizes and position of a table, in pixels and radians."""

    elevation: float
    yaw: float
    """Angle about the vertical axis between the front and the camera."""
    right: float
    down: float
    """Place of the top's upper face, relative to the image's centre."""
    half: float
    """Half width of the top at the front."""
    deep: float
    """Half depth of the top."""
    thick: float
    """Thickness of the top."""
    leg: float
    """Half thickness of the legs and of the backrest."""
    high: float
    """Height of the legs."""
    back: float
    """Height of the backrest."""
    wide: float
    """Half width of the backrest."""
    rear: float
    """Width of the top at the rear, relative to the front."""
    tops: float
    """Place of the legs' upper ends, relative to the top's corners or edge."""
    feet: float
    """Place of the feet, relative to the top's corners or edge."""


@dataclass(frozen=True, eq=False)
class Table:
    """A table, a stool or a chair; x points to the right, and y to the front."""

    kind: Kind
    sizes: Sizes
    distance: float
    """Distance of the camera [pixels]."""

    @cached_property
    def camera(self) -> Raised:
        """The camera that sees the table."""
        return Raised(self.sizes.elevation, self.distance)

    @cached_property
    def axes(self) -> Field:
        """Directions to the right, to the front, and down, in upright coordinates [3,3]."""
        cosine, sine = np.cos(self.sizes.yaw), np.sin(self.sizes.yaw)
        return np.array([[cosine, 0, -sine], [sine, 0, cosine], [0, 1, 0]])

    @cached_property
    def parts(self) -> list[Field]:
        """Corners [C,3] of the top, the legs and the backrest in upright coordinates."""
        s = self.sizes
        under, floor = s.down + s.thick, s.down + s.thick + s.high
        top, legs = self._place(self.kind.top), self._place(self.kind.legs)
        parts = [_between(top, s.down, top, under)]
        for leg in legs:
            upper, lower = (s.leg * SQUARE + part * leg for part in (s.tops, s.feet))
            parts.append(_between(upper, under, lower, floor))
        if self.kind.backed:
            rest = SQUARE * [s.wide, s.leg] + [0, s.leg - s.deep]
            parts.append(_between(rest, s.down - s.back, rest, s.down))
        return [part @ self.axes + [s.right, 0, 0] for part in parts]

    def _place(self, relative: Field) -> Field:
        """Convert positions [N,2] relative to half the top's sides to positions in pixels [N,2]."""
        s = self.sizes
        taper = (1 + s.rear) / 2 + (1 - s.rear) / 2 * relative[:, 1]
        return relative * [s.half, s.deep] * np.stack([taper, np.ones(len(relative))], axis=1)

    @cached_property
    def places(self) -> Field:
        """Positions of all corners in the image, relative to the image's centre [C,2], pixels."""
        return self.camera.pixels(np.concatenate(self.parts))

    def resize(self, **sizes: float) -> Table:
        """Return the table with other sizes."""
        return replace(self, sizes=self.sizes._replace(**sizes))

    def boards(self) -> list[Board]:
        """Return the top, the legs and the backrest."""
        names = ["top", *["leg"] * len(self.kind.legs), *["back"] * self.kind.backed]
        return [Board(part, name, self.axes) for part, name in zip(self.parts, names, strict=True)]

    def draw(self, shape: tuple[int, ...], middle: Field, scale: int) -> Field:
        """Draw the silhouette [H/scale,W/scale] in 0..1.

        Args:
            shape: Height and width of the image, multiples of `scale`.
            middle: Column and row at the centre of the image [2].
            scale: Factor by which the drawing is smaller than the image.
        """
        fine = max(1, scale // 2)  # averages over 2 x 2 pixels smooth the edges
        drawn = np.zeros([side // fine for side in shape], np.uint8)
        places = ((self.places + middle + 0.5) / fine - 0.5).astype(np.float32)
        for part in np.split(places, np.cumsum([len(part) for part in self.parts])[:-1]):
            hull = np.rint(16 * cv2.convexHull(part)).astype(np.int32)
            cv2.fillConvexPoly(drawn, hull, 255, shift=4)
        return shrink(drawn / 255.0, scale // fine)


def shrink(values: Field, scale: int) -> Field:
    """Average values [H,W] over squares of `scale` pixels."""
    height, width = values.shape
    size = (width // scale, height // scale)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float64)


def _between(first: Field, upper: float, second: Field, lower: float) -> Field:
    """Return the corners [2C,3] of a solid between two horizontal polygons [C,2]."""
    levels = np.repeat([upper, lower], [len(first), len(second)])
    return np.column_stack([np.concatenate([first, second]), levels])
