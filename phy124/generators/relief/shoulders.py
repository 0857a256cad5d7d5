"""Finds the flat upper edge of a body from which other parts rise, such as the rim of a flower pot.

A solid that is rounded everywhere would have a sharp ridge at this edge. The silhouette is
therefore cut at the edge, body and parts are inflated separately, and a horizontal plane closes the
body.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.ends import CORNERED, Continued
from phy124.generators.relief.height import Silhouette, nearest_of
from phy124.generators.relief.picture import PADDING, WORK
from phy124.generators.relief.solids import RIM, is_turned, round_thickness
from phy124.generators.relief.surface import Surface, View

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
HEIGHT = 0.03
"""Largest height of the edge, relative to the object's width."""
SLOPE = 0.25
"""Largest mean slope of the edge."""
COVERED = 0.5
"""At least this fraction of the edge must be visible, and of its parts near both ends."""
SIDE = 0.12
"""Length of the edge near an end, relative to the body's width."""
WIDE = 0.35
"""Smallest width of the body, relative to the object's width."""
LOW = 0.35
"""Smallest height of the body below the edge, relative to the body's width."""
LENGTH = 0.2
"""Height of the part of the body that is mirrored above the cut, relative to the image."""
THINNEST = 1.0
"""Smallest half thickness of the body at the edge [pixels]."""


@dataclass(frozen=True, eq=False)
class Shoulder:
    """The flat upper edge of a body."""

    row: int
    """First row below the edge."""
    edge: Field
    """First row of the body in each column [W]; NaN outside the body."""
    visible: Mask
    """Columns in which the edge is visible [W]."""

    def round_thickness(self, alpha: Field) -> Field:
        """Return squared half thicknesses [H,W] of parts that are as deep as they are wide."""
        parts = Silhouette.of(self.separate(alpha, PADDING))
        return self.join(round_thickness(parts, WORK), alpha)

    def separate(self, alpha: Field, padding: int) -> Field:
        """Return an image [H+N,W] with two silhouettes: the parts, `padding` empty rows, and the
        body.

        Both silhouettes are extended beyond the cut.
        """
        above, below = np.where(self._rises(alpha), alpha, 0.0)[: self.row], alpha[self.row :]
        length = min(round(LENGTH * len(alpha)), len(below) - 1)
        longer = np.repeat(above[-1:], length // 4, axis=0)
        gap = np.zeros((padding, alpha.shape[1]))
        mirrored = np.minimum(below[1 : length + 1], below[0])[::-1]
        mirrored = np.where(np.isfinite(self.edge), mirrored, below[0])
        return np.concatenate([above, longer, gap, mirrored, below])

    def join(self, parts: Field, alpha: Field) -> Field:
        """Undo `separate`: combine values [H+N,W] of the parts and the body into values [H,W]."""
        below = parts[len(parts) - len(alpha) :]
        above = np.pad(parts[: self.row], ((0, len(alpha) - self.row), (0, 0)))
        return np.where(alpha > 0.5, np.where(self._rises(alpha), above, below), 0.0)

    def close(self, surface: Surface, view: View, alpha: Field) -> Surface:
        """Return a surface on which the body ends at a horizontal plane with a rounded rim.

        If the plane is above the camera, the image shows the plane's front edge; otherwise, it
        shows the plane's back edge.
        """
        rows, inside = np.arange(len(alpha))[:, None], surface.w > 0
        body = np.isfinite(self.edge) & ~self._rises(alpha) & inside
        near = body & (rows < self.row + RIM)
        # The midsurface of a rounded edge would be shifted, so it is copied from below the edge.
        m = np.where(near, surface.m[self.row + round(RIM)], surface.m)
        half = np.sqrt(np.maximum(surface.w, 0.0))
        level = self.edge - 0.5 - view.middle[1]
        level = level * view.k(np.copysign(half[self.row], -level))
        y = rows - view.middle[1]
        plane = view.distance * (1 - level / np.where(y == 0, 1e-9, y))
        front, back = m + half, m - half
        front = np.where(body & (y > 0), np.minimum(front, plane), front)
        back = np.where(body & (y < 0), np.maximum(back, plane), back)
        thick = np.maximum((front - back) / 2, np.minimum(half, THINNEST)) ** 2
        rounded = np.clip((nearest_of(alpha <= 0.5)[0] - 0.5) / RIM, 0, 1)
        w = np.where(body, np.where(near, thick * rounded, thick), surface.w)
        return Surface.of(w, np.where(body, (front + back) / 2, surface.m))

    def _rises(self, alpha: Field) -> Mask:
        """Return which pixels [H,W] are above the body."""
        last = np.where(self.visible, self.edge - 1, self.row)
        return np.arange(len(alpha))[:, None] < last


def find_shoulder(picture: Continued) -> Shoulder | None:
    """Return the widest flat upper edge of a standing body, or None.

    Solids of revolution and objects with a flat top need no such edge.
    """
    solid = picture.object_mask
    if [end.sign for end in picture.ends] != [1] or picture.body is not None or is_turned(solid):
        return None
    rows, columns = (np.flatnonzero(solid.any(axis=axis)) for axis in (1, 0))
    width = np.ptp(columns) + 1
    height = max(2, round(HEIGHT * width))
    upper = solid & ~np.roll(solid, 1, axis=0)
    widest, shoulder = WIDE * width, None
    for row in range(rows[0] + height, rows[-1] - 2 * height):
        first, last = _longest_run(solid[row])
        if last - first <= widest or not _is_body(solid, row, first, last, 2 * height):
            continue
        seen = upper[row - height : row, first:last]
        visible = seen.any(axis=0) & solid[row - 1, first:last]
        side = max(1, round(SIDE * (last - first)))
        if min(part.mean() for part in (visible, visible[:side], visible[-side:])) < COVERED:
            continue
        edge = (row - height + seen.argmax(axis=0)).astype(np.float64)
        if np.abs(np.diff(edge[visible])).mean() > SLOPE:
            continue
        across = np.arange(first, last)
        edge = np.interp(across, across[visible], edge[visible])
        outer = first, solid.shape[1] - last
        shoulder = Shoulder(
            row, np.pad(edge, outer, constant_values=np.nan), np.pad(visible, outer)
        )
        widest = last - first
    return shoulder


def _is_body(solid: Mask, row: int, first: int, last: int, depth: int) -> bool:
    """Whether the columns `first` to `last` of a row are the upper end of a high body. The body
    must be hardly wider at `depth` rows below this row.
    """
    start, end = _longest_run(solid[row + depth])
    if last - first < CORNERED * (end - start):
        return False
    columns = solid[row:, first:last]
    heights = np.where(columns.all(axis=0), len(columns), (~columns).argmax(axis=0))
    return float(np.median(heights)) >= LOW * (last - first)


def _longest_run(line: Mask) -> tuple[int, int]:
    """Return the first column of the longest run of True values [W], and the column after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
    if not len(edges):
        return 0, 0
    longest = 2 * int((edges[1::2] - edges[::2]).argmax())
    return int(edges[longest]), int(edges[longest + 1])
