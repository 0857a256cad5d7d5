"""Recognises rings and bracelets that lie on the floor and were photographed from above.

The section of a ring is an ellipse or a rounded rectangle. Section and elevation follow from the
edges of the outline and of the hole.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.lathe import revolve, spread_turned
from phy124.generators.relief.shell import DRAWN_IN, Shell

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
LOWEST, HIGHEST = np.radians([3.0, 60.0]).tolist()
"""Limits of the camera's elevation [radians]. Outside these limits, the image may show a ring that
stands upright.
"""
OVERLAP = 0.93
"""Smallest overlap (IoU) of the silhouette with the ring's image."""
FACING = 0.2
"""A point gets the image's colour if its normal and the view ray have at least this cosine."""
SECTION = np.linspace(0, 2 * np.pi, 65)
"""Angles around the section; 0 is outside, a quarter turn is above [radians]."""
ROUND, SQUARE = 1.0, 0.2
"""Exponents of the cosine and the sine in `Ring.path`: an ellipse, and a rounded rectangle."""
AROUND = np.linspace(0, 2 * np.pi, 129)
"""Angles around the axis; 0 points to the camera [radians]."""


@dataclass(frozen=True, eq=False)
class Ring:
    """A ring with a vertical axis through the centre of the image."""

    camera: Raised
    radius: float
    """Distance of the section's centre from the axis [pixels]."""
    height: float
    """Height of the section's centre above the image's centre [pixels]."""
    wide: float
    """Half width of the section [pixels]."""
    high: float
    """Half height of the section [pixels]."""
    exponent: float
    """`ROUND` or `SQUARE`."""

    @classmethod
    def of(cls, values: Field, distance: float, exponent: float) -> Ring:
        """Return the ring of five values: elevation, radius, height, half width, half height."""
        elevation, radius, height, wide, high = values.tolist()
        return cls(Raised(elevation, distance), radius, height, wide, high, exponent)

    @cached_property
    def path(self) -> Field:
        """Radius and height along the section [SECTION,2]."""
        circle = np.stack([np.cos(SECTION), np.sin(SECTION)], axis=1)
        unit = np.sign(circle) * np.abs(circle) ** self.exponent
        return unit * [self.wide, self.high] + [self.radius, self.height]

    def image(self) -> Field:
        """Return the surface points projected to the image, relative to its centre
        [A,SECTION,2].
        """
        ring = np.tile(self.path, (len(AROUND), 1))
        points = revolve(ring, np.repeat(AROUND, len(SECTION)))
        return self.camera.pixels(points).reshape(len(AROUND), len(SECTION), 2)

    def edges(self) -> Field:
        """Return half the width, the top and the bottom of the outline, then of the hole [6]."""
        column, row = np.moveaxis(self.image(), 2, 0)
        across = np.linspace(0, column.max(), len(AROUND))
        quarter = len(AROUND) // 4
        near, far = slice(quarter + 1), slice(2 * quarter, quarter - 1, -1)
        bottom = _lines(across, column[near], row[near], np.inf).min(axis=0)
        top = _lines(across, column[far], row[far], -np.inf).max(axis=0)
        # The hole ends where the upper edge of the near half meets the lower edge of the far half.
        gap = bottom - top
        end = max(1, int((gap <= 0).argmax()))
        before, after = gap[end - 1], max(gap[end], -1e3)
        part = np.clip(before / max(before - after, 1e-9), 0, 1)
        inner = across[end - 1] + part * across[1]
        return np.array([column.max(), row.min(), row.max(), inner, top[0], bottom[0]])

    def covers(self, object_mask: Mask, middle: Field) -> float:
        """Return the overlap (IoU) of the ring's image with a silhouette [H,W]."""
        drawn = np.zeros(object_mask.shape, np.uint8)
        places = (self.image() + middle).astype(np.float32)
        for pair in pairwise(places):
            hull = cv2.convexHull(np.concatenate(pair))
            cv2.fillConvexPoly(drawn, np.rint(16 * hull).astype(np.int32), 1, shift=4)
        both = np.count_nonzero(object_mask & (drawn > 0))
        return both / np.count_nonzero(object_mask | (drawn > 0))

    def shell(self, count: int, front: Field, middle: Field) -> Shell:
        """Return the shell with the image's colours.

        Hidden points have the colour of the nearest visible point in the same section.

        Args:
            count: Approximate number of points.
            front: Colours of the image [H,W,3].
            middle: Column and row of the ring's axis in the image [2].
        """
        rings, angles, normals, pitch = spread_turned(self.path, count)
        inner = rings - DRAWN_IN * normals
        source = np.where(
            self._faces(rings, normals, angles)[:, None], inner, self._nearest_seen(rings, angles)
        )
        places = self.camera.pixels(revolve(source, angles)) + middle
        rgb = [
            scipy.ndimage.map_coordinates(front[..., c], places.T[::-1], order=1, mode="nearest")
            for c in range(3)
        ]
        turned = revolve(normals, angles)
        return Shell(revolve(inner, angles), turned, np.full(len(rings), pitch), np.stack(rgb, 1))

    def _faces(self, rings: Field, normals: Field, angles: Field) -> Mask:
        eye = self.camera.distance * self.camera.turn[2]
        rays = eye - revolve(rings, angles)
        facing = (rays * revolve(normals, angles)).sum(axis=1)
        return facing > FACING * np.linalg.norm(rays, axis=1)

    def _nearest_seen(self, rings: Field, angles: Field) -> Field:
        """Return radius and height of the nearest points that face the camera [N,2]."""
        steps = np.diff(self.path, axis=0)
        normals = steps[:, ::-1] * [1, -1] / np.linalg.norm(steps, axis=1, keepdims=True)
        middles = (self.path[1:] + self.path[:-1]) / 2
        seen, least = rings.copy(), np.full(len(rings), np.inf)
        for place, normal in zip(middles, normals, strict=True):
            same, turned = (np.broadcast_to(pair, rings.shape) for pair in (place, normal))
            away = np.hypot(*(rings - place).T)
            nearer = self._faces(same, turned, angles) & (away < least)
            seen[nearer], least[nearer] = place - DRAWN_IN * normal, away[nearer]
        return seen


def find_ring(
    object_mask: Mask, middle: Field, distance: float, elevation: float | None
) -> Ring | None:
    """Return the ring that a raised camera sees; None if the silhouette shows no ring.

    Args:
        object_mask: The silhouette [H,W].
        middle: Column and row of the image's centre [2].
        distance: Distance of the camera [pixels].
        elevation: Elevation of the camera [radians]; None: estimated from the silhouette.
    """
    edges = _edges(object_mask, middle)
    if edges is None:
        return None
    width, top, bottom, inner, hole_top, hole_bottom = edges
    # A circle halfway between outline and hole is seen as an ellipse, which shows the elevation.
    tilt = (bottom - top + hole_bottom - hole_top) / 2 / (width + inner)
    if not np.sin(LOWEST) < tilt < np.sin(HIGHEST):
        return None
    thick = (width - inner) / 2
    low = np.array([LOWEST, inner / 2, -width, 0.2 * thick, 0.5])
    high = np.array([HIGHEST, 1.5 * width, width, 2 * thick, width])
    start = [np.arcsin(tilt), width - thick, 0.0, thick, max(thick, 1.0)]
    if elevation is not None:
        low[0], high[0], start[0] = elevation - 1e-6, elevation + 1e-6, elevation
    rings = []
    for exponent in (ROUND, SQUARE):
        fit = scipy.optimize.least_squares(
            lambda values, kind=exponent: Ring.of(values, distance, kind).edges() - edges,
            np.clip(start, low + 1e-9, high - 1e-9),
            bounds=(low, high),
            x_scale=[0.1, *[thick] * 4],
        )
        rings.append(Ring.of(fit.x, distance, exponent))
    overlaps = [ring.covers(object_mask, middle) for ring in rings]
    return rings[np.argmax(overlaps)] if max(overlaps) >= OVERLAP else None


def _edges(object_mask: Mask, middle: Field) -> Field | None:
    """Return a silhouette's edges in the order of `Ring.edges`; None unless it has exactly one
    hole.
    """
    holes, number = scipy.ndimage.label(~np.pad(object_mask, 1))  # pyright: ignore
    if number != 2:
        return None
    hole = holes[1:-1, 1:-1] == 3 - holes[0, 0]
    edges = []
    for mask in (object_mask, hole):
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        edges += [(np.ptp(columns) + 1) / 2, rows[0] - 0.5 - middle[1], rows[-1] + 0.5 - middle[1]]
    return np.array(edges)


def _lines(across: Field, column: Field, row: Field, beyond: float) -> Field:
    """Return the row [S,C] at which each line [A,S] crosses each column; columns to the right of a
    line's end get the row `beyond`.
    """
    lines = zip(np.maximum.accumulate(column, axis=0).T, row.T, strict=True)
    return np.stack([np.interp(across, *line, right=beyond) for line in lines])
