"""Builds vessels and drums, with a horizontal lid, from the image of a raised camera.

A raised camera sees the circles of a solid of revolution as ellipses, which are rounder from higher
elevations. Flat ellipses can fill any outline. The elevation is therefore assumed to be the largest
one at which the circles fill the silhouette.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.upright import Profile

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
ELEVATIONS = np.radians([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
"""Elevations that are tried first [radians]. If the circles fill the outline even at the last
elevation, as for a ball, the outline shows no elevation.
"""
HALVINGS = 3
"""Number of times the step between elevations is halved."""
LEFT = 0.015
"""Largest fraction of the silhouette that no circle covers."""
MORE = 0.004
"""Largest difference of the empty fraction from the minimum over all elevations."""
ANGLES = np.linspace(0, np.pi, 33)
"""Directions in which a circle is compared with the outline; 0 points to the camera [radians]."""
EDGE = 1.0
"""Largest distance of a circle from the first or last row that it touches [pixels]."""
SHALLOW, SLANTED, SMALL_FOOT = 0.5, 0.5, 0.4
"""Largest height of a bowl's visible wall, relative to the rim's radius. `SLANTED` is the smallest
slope of this wall, relative to the slope of an invisible wall. `SMALL_FOOT` is the radius of a
bowl's foot, relative to the rim's radius.
"""
NEIGHBOURS, STILL = 11, 4.0
"""Circles above a flat ledge are hidden, and touch the outline at the same corner. A circle belongs
to them if those of `NEIGHBOURS` circles touch the outline in rows that differ by less than `STILL`
[pixels].
"""
TOPPING = 0.15
"""Smallest radius of a knob on a lid, relative to the largest radius. Smaller parts are assumed to
lie somewhere else on the lid, such as a berry on a cake.
"""
CLEAR = 0.95
"""Fraction of a ring's visible angle in which the image is not stretched too much."""
STEEP = 0.2
"""Smallest visible angle from the front at which a ring gets colours from the image [radians]."""


@dataclass(frozen=True, eq=False)
class Lathe:
    """A solid of revolution, from the base to the lid."""

    heights: Field
    """Heights of the circles above the object's centre [M], pixels."""
    radii: Field
    """Radii of the circles [M], pixels."""
    camera: Raised
    hidden: Mask
    """Whether a circle is not visible in the outline, as above a ledge [M]."""

    @classmethod
    def fill(cls, profile: Profile, middle: float, camera: Raised, step: float = 1.0) -> Lathe:
        """Return the largest circles inside an outline, from the lowest to the highest.

        Args:
            profile: The outline.
            middle: Row of the image's centre.
            camera: The camera.
            step: Distance between the circles [pixels].
        """
        rows = profile.rows - middle
        reach = 1.5 * len(rows)
        heights = np.arange(-reach, reach, step)
        low, high = np.zeros(len(heights)), np.full(len(heights), 1.3 * profile.half.max())
        for _ in range(12):
            radii = (low + high) / 2
            column, row = _images(heights, radii, camera)
            half = np.interp(row, rows, profile.half, left=-1.0, right=-1.0)
            fits = (column <= half + 0.25).all(axis=1)
            low, high = np.where(fits, radii, low), np.where(fits, high, radii)
        kept = low > 1
        column, row = _images(heights[kept], low[kept], camera)
        nearest = (np.interp(row, rows, profile.half) - column).argmin(axis=1)
        touched = np.take_along_axis(row, nearest[:, None], axis=1)[:, 0]
        highest = scipy.ndimage.minimum_filter1d(touched, NEIGHBOURS)
        still = scipy.ndimage.maximum_filter1d(touched, NEIGHBOURS) - highest < STILL
        hidden = scipy.ndimage.binary_dilation(still, np.ones(NEIGHBOURS))
        return cls(heights[kept], low[kept], camera, hidden)

    def between(self, first: float, last: float) -> Lathe | None:
        """Cut off the circles below the base and above the lid; return None if nothing is left.

        The circles beyond base and lid form cones that the camera does not see. A bowl contains a
        part of the lower cone.
        """
        row = _images(self.heights, self.radii, self.camera)[1]
        top = np.flatnonzero(row.min(axis=1) <= first + EDGE)
        bottom = np.flatnonzero(row.max(axis=1) >= last - EDGE)
        if not len(top) or not len(bottom) or top[0] - bottom[-1] < 2:
            return None
        return self._level(base=self._foot(bottom[-1], top[0]), lid=top[0])

    def _level(self, base: int, lid: int) -> Lathe:
        """Return the solid from the base to the lid, with flat ledges.

        Above a ledge, circles are hidden. They are replaced by the next visible circle, such as
        that of a knob, or omitted if this circle is too small.
        """
        kept = np.arange(base, lid + 1)
        ledge = self.hidden[kept] & (kept > base + self.radii[kept].argmax()) & (kept < lid)
        radii = self.radii[kept[~ledge][np.cumsum(~ledge) - ~ledge]]
        small = ledge & (radii < TOPPING * radii.max())
        if small.any():
            kept, radii = kept[: small.argmax()], radii[: small.argmax()]
        walls = np.split(radii, np.flatnonzero(np.diff(ledge[: len(radii)].astype(int)) > 0) + 1)
        smooth = [scipy.ndimage.gaussian_filter1d(wall, 1.5, mode="nearest") for wall in walls]
        return Lathe(self.heights[kept], np.concatenate(smooth), self.camera, self.hidden[kept])

    def _foot(self, base: int, lid: int) -> int:
        rim, middle = float(self.radii[base:lid].max()), (base + lid) // 2
        height = self.heights[lid] - self.heights[base]
        slope = np.diff(self.radii[[base, middle]]) / np.diff(self.heights[[base, middle]])
        hidden = 1 / np.tan(max(self.camera.elevation, 1e-6))
        if height > SHALLOW * rim or slope < SLANTED * hidden:
            return base
        return min(base, int((self.radii >= SMALL_FOOT * rim).argmax()))

    @cached_property
    def path(self) -> Field:
        """Radius and height of the profile, from the base's centre to the lid's centre [M+2,2]."""
        wall = np.stack([self.radii, self.heights], axis=1)
        return np.concatenate([[[0, self.heights[0]]], wall, [[0, self.heights[-1]]]])

    def shell(self, count: int, front: Field, middle: Field, offset: float) -> Shell:
        """Return the shell with the image's colours.

        Hidden parts of the wall get the colours of the mirrored front.

        Args:
            count: Approximate number of points.
            front: Colours of the image [H,W,3].
            middle: Column of the axis and row of the image's centre [2].
            offset: Distance of the axis from the image's centre [pixels].
        """
        rings, angles, normals, pitch = spread_turned(self.path, count)
        rgb = self._colours(rings, angles, normals, front, middle)
        inner = np.maximum(rings - DRAWN_IN * normals, [0.0, -np.inf])
        points = revolve(inner, angles) + np.array([offset, 0, 0])
        return Shell(points, revolve(normals, angles), np.full(len(points), pitch), rgb)

    def _colours(
        self, rings: Field, angles: Field, normals: Field, front: Field, middle: Field
    ) -> Field:
        seen = self._visible(rings, normals)
        wall = (np.abs(normals[:, 0]) > 1e-6) & (seen > STEEP)
        # Rings that are not visible at all have the colours of the nearest visible ring.
        known = np.flatnonzero(wall)
        order = known[np.argsort(rings[known, 1], kind="stable")]
        nearest = np.searchsorted(rings[order, 1], rings[:, 1]).clip(0, len(order) - 1)
        source = np.where(seen > STEEP, np.arange(len(rings)), order[nearest])
        limit = np.where(seen[source] < np.pi, CLEAR * seen[source], np.pi)
        size = np.abs(angles)
        folded = np.where(size <= limit, size, np.minimum(np.pi - size, limit))
        points = revolve(rings[source], np.copysign(folded, angles))
        column, row = self.camera.pixels(points).T
        place = [row + middle[1], column + middle[0]]
        rgb = [
            scipy.ndimage.map_coordinates(front[..., c], place, order=1, mode="nearest")
            for c in range(3)
        ]
        colours = np.stack(rgb, axis=1)
        for hidden in (normals[:, 1] == side for side in (-1, 1)):
            if hidden.any() and seen[hidden].max() <= STEEP:
                colours[hidden] = np.median(colours[hidden], axis=0)
        return colours

    def _visible(self, rings: Field, normals: Field) -> Field:
        """Return the largest angle from the front at which the camera sees a ring [N], radians."""
        (radius, height), (out, up) = rings.T, normals.T
        _, eye_height, eye_ahead = self.camera.distance * self.camera.turn[2] * [1, -1, 1]
        hidden = out * radius - up * (eye_height - height)
        cosine = hidden / np.maximum(out * eye_ahead, 1e-9)
        return np.where(
            out > 1e-6, np.arccos(np.clip(cosine, -1, 1)), np.where(hidden < 0, np.pi, 0)
        )


def find_lathe(profile: Profile, middle: float, distance: float) -> Lathe | None:
    """Return the vessel or drum that a raised camera sees; None if no elevation is certain."""

    def empty(elevation: float) -> float:
        lathe = Lathe.fill(profile, middle, Raised(elevation, distance), 2.0)
        return _empty(lathe, profile, middle)

    left = [empty(elevation) for elevation in ELEVATIONS.tolist()]
    most = min(left) + MORE
    filled = np.flatnonzero(np.array(left) <= most)[-1]
    if min(left) > LEFT or filled == len(ELEVATIONS) - 1:
        return None
    low, high = ELEVATIONS[filled : filled + 2].tolist()
    for _ in range(HALVINGS):
        elevation = (low + high) / 2
        low, high = (elevation, high) if empty(elevation) <= most else (low, elevation)
    return cut_lathe(profile, middle, Raised((low + high) / 2, distance))


def cut_lathe(profile: Profile, middle: float, camera: Raised) -> Lathe | None:
    """Return the solid of revolution in an outline; None if it has no wall."""
    first, last = profile.rows[[0, -1]] - middle
    return Lathe.fill(profile, middle, camera).between(first, last)


def spread_turned(path: Field, count: int) -> tuple[Field, Field, Field, float]:
    """Distribute points evenly over a solid of revolution.

    Args:
        path: Radius and height of the outline [M,2]; the solid is on the left.
        count: Approximate number of points.

    Returns:
        Radius and height [N,2], angle from the front [N], radial and upward component of the
        outward normal [N,2], and spacing of the points.
    """
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    area = np.pi * float(((path[1:, 0] + path[:-1, 0]) * lengths).sum())
    pitch = float(np.sqrt(area / count))
    edge = pitch * (4 / 3) ** 0.25  # each point of the lattice has the area pitch^2
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    along = np.linspace(0, ends[-1], max(8, round(ends[-1] / (edge * 3**0.5 / 2))))
    segment = np.clip(np.searchsorted(ends, along, side="right") - 1, 0, len(lengths) - 1)
    normals = (steps[:, ::-1] * [1, -1] / np.maximum(lengths, 1e-9)[:, None])[segment]
    ring = np.stack([np.interp(along, ends, part) for part in path.T], axis=1)
    numbers = np.maximum(1, np.rint(2 * np.pi * ring[:, 0] / edge)).astype(int)
    owner = np.repeat(np.arange(len(ring)), numbers)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    # Every second ring is turned by half a spacing.
    angles = 2 * np.pi * (place + 0.5 * (owner % 2)) / numbers[owner]
    return ring[owner], (angles + np.pi) % (2 * np.pi) - np.pi, normals[owner], pitch


def _images(heights: Field, radii: Field, camera: Raised) -> tuple[Field, Field]:
    """Return columns and rows [M,A] of the circles' right halves, relative to the axis."""
    rings = np.stack([np.repeat(radii, len(ANGLES)), np.repeat(heights, len(ANGLES))], axis=1)
    pixels = camera.pixels(revolve(rings, np.tile(ANGLES, len(radii))))
    column, row = pixels.T.reshape(2, len(radii), len(ANGLES))
    return column, row


def revolve(rings: Field, angles: Field) -> Field:
    """Convert radial and upward components [N,2] at angles [N] to vectors [N,3]."""
    radius, height = rings.T
    return np.stack([radius * np.sin(angles), -height, radius * np.cos(angles)], axis=1)


def _empty(lathe: Lathe, profile: Profile, middle: float) -> float:
    wide = int(profile.half.max()) + 2
    drawn = np.zeros((len(profile.half), wide), np.uint8)
    column, row = _images(lathe.heights, lathe.radii, lathe.camera)
    first = profile.rows[0] - middle
    # The last points are on the axis, so that the right half of the circle is closed.
    for outline in np.rint(16 * np.stack([column, row - first], axis=2)).astype(np.int32):
        cv2.fillConvexPoly(drawn, outline, 1, shift=4)
    solid = np.arange(wide) < profile.half[:, None]
    return 1 - np.count_nonzero(solid & (drawn > 0)) / np.count_nonzero(solid)
