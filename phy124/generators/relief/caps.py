"""Closes the flat ends of an object, and colours the end faces, which no image shows."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.ends import End
from phy124.generators.relief.solids import RIM
from phy124.generators.relief.surface import Surface, View

Field = NDArray[np.float64]
SEEN = 0.7
"""Weight of the end's front edge in the height of a flat end. The height is a weighted mean of the
heights of the front edge and of the end's corners. For separate feet, the weight is 1.
"""
STRIP = 8
"""Height of the strip of the image whose colours a flat end gets [pixels]."""
BLUR = 12.0
"""Blur of the end's colours, as a standard deviation [pixels]."""


@dataclass(frozen=True, eq=False)
class Plane:
    """The horizontal plane of a flat end.

    A part that would appear outside the outline is replaced by a bevel along the view rays.
    """

    level: float
    """Projected y of the plane [pixels]."""
    outline: Field
    """Last row of the object in each column [W]."""
    view: View
    sign: int
    """1 for the bottom, -1 for the top."""

    def rows(self, columns: Field, z: Field) -> tuple[Field, NDArray[np.bool_]]:
        """Return the rows [N] of the face, and whether the rows are bevelled.

        `columns` [N] are coordinates before projection; `z` [N] increases towards the camera.
        """
        flat = self.level / self.view.k(z) + self.view.middle[1]
        outline = np.interp(columns, np.arange(len(self.outline)), self.outline)
        bevelled = self.sign * outline < self.sign * flat
        return np.where(bevelled, outline, flat), bevelled

    def normals(self, columns: Field, z: Field) -> Field:
        """Return unit normals before projection [N,3]; the arguments are as in `rows`."""
        tilt = np.where(
            self.rows(columns, z)[1], 0.0, -self.level / self.view.distance / self.view.k(z) ** 2
        )
        normals = self.sign * np.stack([np.zeros_like(z), np.ones_like(z), tilt], axis=1)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def includes(self, points: Field, by: float) -> NDArray[np.bool_]:
        """Whether points [N,3] are on the object's side of the plane, at least `by` pixels from the
        plane.
        """
        x, y, z = points.T
        return (self.rows(x, z)[0] - y) * self.sign * self.view.k(z) >= by


@dataclass(frozen=True, eq=False)
class Cap:
    """The flat face of an end."""

    points: Field
    """Regularly spaced points [M,3], pixels."""
    normals: Field
    """Unit normals before projection [M,3]."""
    plane: Plane
    """The object is cut off at this plane."""
    last: float
    """Last row of the object at the end."""


def make_cap(
    surface: Surface, view: View, end: End, object_mask: NDArray[np.bool_], pitch: float
) -> Cap:
    """Make the flat face of an end.

    Args:
        surface: The inflated solid.
        view: The front camera.
        end: The flat end that the face closes.
        object_mask: Mask of the object, without its mirror images [H,W].
        pitch: Spacing of the points [pixels].
    """
    thick = _thick(surface, end.corner - 0.5 * end.sign)
    feet = _thick(surface, end.outermost - RIM * end.sign) if end.divided else thick
    near = (end.outermost - view.middle[1]) * view.k(np.array(feet))
    seen = 1.0 if end.divided else SEEN
    level = float(seen * near + (1 - seen) * (end.corner - view.middle[1]))
    plane = Plane(level, _outline(end, object_mask), view, end.sign)
    width = surface.w.shape[1]
    x = np.arange(-width / 2, width / 2, pitch)
    z = np.arange(-thick, thick + pitch, pitch * 3**0.5 / 2)
    gx, gz = np.meshgrid(x, z)
    # The points form a triangular lattice: every second line is shifted by half a spacing.
    gx = gx + np.where(np.arange(len(z)) % 2, pitch / 2, 0.0)[:, None]
    depth = gz.ravel()
    column = gx.ravel() / view.k(depth) + view.middle[0]
    points = np.stack([column, plane.rows(column, depth)[0], depth], axis=1)
    value, gradient = surface.gradient(points)
    points = points[value > 0.5 * np.linalg.norm(gradient, axis=1)]
    return Cap(points, plane.normals(points[:, 0], points[:, 2]), plane, end.outermost)


def _outline(end: End, object_mask: NDArray[np.bool_]) -> Field:
    if end.divided:
        return np.full(object_mask.shape[1], end.outermost)
    at_corner = object_mask[int(end.corner - 0.5 * end.sign)]
    length = object_mask[:: -end.sign].argmax(axis=0)
    last = (len(object_mask) - 1 - length if end.sign > 0 else length) + 0.5 * end.sign
    return np.where(at_corner, last, end.outermost)


def _thick(surface: Surface, row: float) -> float:
    return float(np.sqrt(max(surface.w[int(row)].max(), 0.0)))


def colour_cap(cap: Cap, unlit: Field, light: Field) -> Field:
    """Return the colours [M,3] of a cap, which continue the image along the end.

    Args:
        cap: The face to colour.
        unlit: Colours of the front without light [H,W,3].
        light: Direction and strength of the light [3].
    """
    rows = np.clip(cap.last - cap.plane.sign * np.arange(STRIP), 0, len(unlit) - 1).astype(int)
    strip = scipy.ndimage.gaussian_filter1d(unlit[rows].mean(axis=0), BLUR, axis=0)
    columns = np.arange(len(strip))
    colours = np.stack([np.interp(cap.points[:, 0], columns, c) for c in strip.T], axis=1)
    return np.clip(colours * np.exp(cap.normals @ light)[:, None], 0, 1)
