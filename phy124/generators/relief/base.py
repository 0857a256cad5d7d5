"""The flat foot that an object stands on.

Where an object stands, its lowest line in the picture is straight; closing the solid there like at
any other rim would give it a keel. So the silhouette is inflated together with its mirror image
below that line, as if it continued, and then cut off flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
REFLECTED = 0.25
"""Height of the mirror image, in picture heights; farther away it no longer affects the object."""
FLAT = 0.2
"""Fraction of the width that a flat lowest line must have; a ball has 0.12 within a pixel."""
WIDEST = 0.02
"""How much wider than the silhouette the back may be, as a fraction."""


def reflected(rgba: Field, padding: int) -> tuple[Field, float]:
    """The picture [H,W,4] with its mirror image below, and the y of the line between, pixels.

    If the object does not end in a flat line, the picture stays unchanged and the line lies below
    it.
    """
    solid = rgba[..., 3] > 0.5
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    touching = solid[max(0, last - 1) : last + 1].any(axis=0)
    if np.count_nonzero(touching) < FLAT * np.count_nonzero(solid.any(axis=0)):
        return rgba, float(len(rgba))
    rows = max(1, min(last, round(REFLECTED * len(rgba))))
    upper = rgba[: last + 1]
    lower = upper[::-1][:rows]
    return np.concatenate([upper, lower, np.zeros_like(rgba[:padding])]), last + 0.5


@dataclass(frozen=True)
class View:
    """How the front camera contracts the front, so that it sees each point over its pixel.

    x' = x k(z), y' = y k(z) around the middle, with k = 1 - z / distance. Behind the rim k levels
    off at once, so that the back is hardly wider and there is no edge at z = 0.
    """

    middle: Field
    """Pixel that the camera looks at [3], z = 0."""
    distance: float
    """Distance of the camera, pixels."""

    def k(self, z: Field) -> Field:
        """Scale factor at depth z."""
        behind = 1 + WIDEST * (1 - np.exp(np.minimum(z, 0) / (self.distance * WIDEST)))
        return np.where(z > 0, 1 - z / self.distance, behind)

    def slope(self, z: Field) -> Field:
        """Derivative of k, 1/pixel."""
        return -np.exp(np.minimum(z, 0) / (self.distance * WIDEST)) / self.distance

    def drawn(self, points: Field, normals: Field) -> tuple[Field, Field]:
        """Points [N,3] relative to the middle, and unit normals, both contracted."""
        flat, z = (points - self.middle)[:, :2], points[:, 2:]
        k, slope = self.k(z), self.slope(z)
        across = normals[:, :2] / k
        along = normals[:, 2:] - slope * (flat * across).sum(axis=1, keepdims=True)
        turned = np.concatenate([across, along], axis=1)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return np.concatenate([flat * k, z], axis=1), turned

    def undrawn(self, points: Field) -> Field:
        """The pixels [N,3] of contracted points [N,3]."""
        flat, z = points[:, :2], points[:, 2:]
        return np.concatenate([flat / self.k(z), z], axis=1) + self.middle


def foot(surface: Surface, view: View, base: float, pitch: float) -> tuple[Field, Field, float]:
    """The flat underside, at the height where the line meets the thickest part of the front.

    The front camera thus sees its edge on the line; everything contracted to below it is to be cut
    off.

    Args:
        surface: The inflated solid.
        view: The front camera.
        base: y of the line, pixels.
        pitch: Spacing of the points, pixels.

    Returns:
        Points [M,3], normals [M,3] and the contracted y of the foot, pixels.
    """
    row = surface.w[min(int(base), len(surface.w) - 1)]
    thick = float(np.sqrt(max(row.max(), 0.0)))
    floor = float((base - view.middle[1]) * view.k(np.array(0.7 * thick)))
    width = surface.w.shape[1]
    x = np.arange(-width / 2, width / 2, pitch)
    z = np.arange(-thick, thick + pitch, pitch * 3**0.5 / 2)
    gx, gz = np.meshgrid(x, z)
    # A triangular lattice: every second line is shifted by half a step.
    gx = gx + np.where(np.arange(len(z)) % 2, pitch / 2, 0.0)[:, None]
    drawn = np.stack([gx.ravel(), np.full(gx.size, floor), gz.ravel()], axis=1)
    points = view.undrawn(drawn)
    value, gradient = surface.gradient(points)
    points = points[value > 0.5 * np.linalg.norm(gradient, axis=1)]
    depth = points[:, 2]
    tilt = floor * view.slope(depth) / view.k(depth) ** 2
    normals = np.stack([np.zeros_like(tilt), np.ones_like(tilt), tilt], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), floor
