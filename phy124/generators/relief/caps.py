"""Closes the flat ends of an object, and colours these faces, which no image shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.ends import End
from phy124.generators.relief.solids import RIM
from phy124.generators.relief.surface import Surface, View

Field = NDArray[np.float64]
SEEN = 0.7
"""The height of a flat end's plane is a weighted mean. The object's front edge, which is seen on
the image's lowest line, has this weight; the end's corners have the rest. (For divided feet, the
weight is 1.)"""
STRIP, BLUR = 8, 12.0
"""Height of the strip of the image along an end that determines the end's colours, and their blur
[pixels]."""


@dataclass(frozen=True)
class Plane:
    """The horizontal plane of a flat end. Where the plane's near part would appear beyond the
    object's last row in the image, a bevel along the view rays of that row replaces it.
    """

    level: float
    """Projected y of the plane [pixels]."""
    last: float
    """The object's last row, relative to the image centre [pixels]."""
    distance: float
    """Distance of the camera from the object's centre [pixels]."""
    sign: int
    """1 for the bottom, -1 for the top."""

    def height(self, z: Field) -> Field:
        """Return the projected y of the plane or bevel at coordinates z."""
        bevel = self.last * (1 - z / self.distance)
        return np.where(self.is_bevel(z), bevel, self.level)

    def is_bevel(self, z: Field) -> NDArray[np.bool_]:
        """Whether the bevel replaces the plane at coordinates z."""
        return self.sign * self.last * (1 - z / self.distance) < self.sign * self.level

    def normals(self, z: Field) -> Field:
        """Return unit normals before projection [M,3] at coordinates z [M]."""
        tilt = -self.level * self.distance / (self.distance - z) ** 2
        tilt = np.where(self.is_bevel(z), 0.0, tilt)
        normals = self.sign * np.stack([np.zeros_like(z), np.ones_like(z), tilt], axis=1)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def includes(self, points: Field, by: float) -> NDArray[np.bool_]:
        """Whether projected points [M,3] are inside the plane by at least `by` pixels."""
        return (self.height(points[:, 2]) - points[:, 1]) * self.sign >= by


@dataclass(frozen=True)
class Cap:
    """The flat face at an end of the object."""

    points: Field
    """Lattice of points on the face [M,3], pixels."""
    normals: Field
    """Normals before projection [M,3]."""
    plane: Plane
    """The plane of the face; everything beyond it is cut off."""


def make_cap(surface: Surface, view: View, end: End, pitch: float) -> Cap:
    """Make the flat face of an end, at the height that follows from the end's rows in the image.

    Args:
        surface: The inflated solid.
        view: The front camera.
        end: The end.
        pitch: Spacing of the points, pixels.
    """
    thick = _thick(surface, end.corner - 0.5 * end.sign)
    feet = _thick(surface, end.outermost - RIM * end.sign) if end.divided else thick
    last = end.outermost - view.middle[1]
    near = last * view.k(np.array(feet))
    seen = 1.0 if end.divided else SEEN
    level = float(seen * near + (1 - seen) * (end.corner - view.middle[1]))
    plane = Plane(level, float(last), view.distance, end.sign)
    width = surface.w.shape[1]
    x = np.arange(-width / 2, width / 2, pitch)
    z = np.arange(-thick, thick + pitch, pitch * 3**0.5 / 2)
    gx, gz = np.meshgrid(x, z)
    # A triangular lattice: every second line is shifted by half a spacing.
    gx = gx + np.where(np.arange(len(z)) % 2, pitch / 2, 0.0)[:, None]
    depth = gz.ravel()
    points = view.unproject(np.stack([gx.ravel(), plane.height(depth), depth], axis=1))
    value, gradient = surface.gradient(points)
    points = points[value > 0.5 * np.linalg.norm(gradient, axis=1)]
    return Cap(points, plane.normals(points[:, 2]), plane)


def _thick(surface: Surface, row: float) -> float:
    """Return the largest half thickness in a row [pixels]."""
    return float(np.sqrt(max(surface.w[int(row)].max(), 0.0)))


def colour_cap(cap: Cap, view: View, unlit: Field, light: Field) -> Field:
    """Return the colours [M,3] of a cap: those that the image shows along the end.

    Args:
        cap: The face.
        view: The front camera.
        unlit: Colours of the front without light [H,W,3].
        light: Direction and strength of the light [3].
    """
    last = cap.plane.last + view.middle[1]
    rows = np.clip(last - cap.plane.sign * np.arange(STRIP), 0, len(unlit) - 1).astype(int)
    strip = scipy.ndimage.gaussian_filter1d(unlit[rows].mean(axis=0), BLUR, axis=0)
    columns = np.arange(len(strip))
    colours = np.stack([np.interp(cap.points[:, 0], columns, c) for c in strip.T], axis=1)
    return np.clip(colours * np.exp(cap.normals @ light)[:, None], 0, 1)
