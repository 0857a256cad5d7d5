"""The flat faces at an object's ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.ends import End
from phy124.generators.relief.solids import RIM
from phy124.generators.relief.surface import Surface
from phy124.generators.relief.view import View

Field = NDArray[np.float64]
SEEN = 0.7
"""Fraction of the thickness at which an end's plane meets the picture's lowest line; where that is
an outline of feet, it meets the front."""


@dataclass(frozen=True)
class Cap:
    """The flat face at an end."""

    points: Field
    """Even lattice over it [M,3], pixels."""
    normals: Field
    """[M,3], not yet contracted."""
    level: float
    """Its contracted y, pixels: everything farther out is to be cut off."""
    sign: int

    def within(self, y: Field, by: float) -> NDArray[np.bool_]:
        """Which contracted heights are farther in by so many pixels."""
        return (self.level - y) * self.sign >= by


def cap(surface: Surface, view: View, end: End, pitch: float) -> Cap:
    """The flat face at the height where the line meets the thickest part of the front.

    The front camera thus sees its edge on the line.

    Args:
        surface: The inflated solid.
        view: The front camera.
        end: Where it is.
        pitch: Spacing of the points, pixels.
    """
    thick = _thick(surface, end.corner - 0.5 * end.sign)
    feet = _thick(surface, end.outermost - RIM * end.sign) if end.divided else thick
    near = (end.outermost - view.middle[1]) * view.k(np.array(feet))
    seen = 1.0 if end.divided else SEEN
    level = float(seen * near + (1 - seen) * (end.corner - view.middle[1]))
    width = surface.w.shape[1]
    x = np.arange(-width / 2, width / 2, pitch)
    z = np.arange(-thick, thick + pitch, pitch * 3**0.5 / 2)
    gx, gz = np.meshgrid(x, z)
    # A triangular lattice: every second line is shifted by half a step.
    gx = gx + np.where(np.arange(len(z)) % 2, pitch / 2, 0.0)[:, None]
    drawn = np.stack([gx.ravel(), np.full(gx.size, level), gz.ravel()], axis=1)
    points = view.undrawn(drawn)
    value, gradient = surface.gradient(points)
    points = points[value > 0.5 * np.linalg.norm(gradient, axis=1)]
    depth = points[:, 2]
    tilt = -level / view.distance / view.k(depth) ** 2
    normals = end.sign * np.stack([np.zeros_like(tilt), np.ones_like(tilt), tilt], axis=1)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Cap(points, normals, level, end.sign)


def _thick(surface: Surface, row: float) -> float:
    """Largest half thickness in a row, pixels."""
    return float(np.sqrt(max(surface.w[int(row)].max(), 0.0)))
