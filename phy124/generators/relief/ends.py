"""Detects the flat ends of an object: the base on which the object stands, and a flat top.

The solid would have a sharp ridge at a flat end if it were rounded there. To avoid the ridge, the
silhouette is mirrored at the end, inflated, and then cut off flat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from phy124.generators.relief.upright import upright_body

Field = NDArray[np.float64]
MIRRORED = 0.25
"""Height of the mirror image, relative to the image; a larger value changes little."""
FLAT = 0.2
"""Smallest width of a flat end, relative to the object's width."""
ARC = 0.15
"""Largest height of an end's arc, relative to the end's width."""
CURVED, STRAIGHT = 4, 2
"""Smallest height of an arc, and largest height of a straight edge [pixels]."""
CORNERED = 0.92
"""Smallest ratio of the width at the start of an end's arc to the width at twice the arc's height.
For a ball, this ratio is 0.74.
"""
RAGGED = 0.03
"""Smallest depth of a gap between parts, relative to the end's width. Shallower gaps are
irregularities of the mask.
"""
TALL = 0.8
"""Smallest ratio of height to width of a standing object; flatter objects lie."""


@dataclass(frozen=True)
class End:
    """A flat end of the object; rows are counted from the top of the image."""

    corner: float
    """Row at which the arc begins and the silhouette is mirrored."""
    outermost: float
    """Row at which the arc ends."""
    sign: int
    """1 for the bottom, -1 for the top."""
    divided: bool = False
    """Whether the end shows several round feet instead of a single arc."""

    def beyond(self, y: Field, by: float = 0.0) -> NDArray[np.bool_]:
        """Whether each row lies beyond the end by more than `by` pixels."""
        return (y - self.outermost) * self.sign > by


@dataclass(frozen=True, eq=False)
class Continued:
    """An image with a silhouette that is extended beyond flat ends."""

    rgba: Field
    """Image [H,W,4] with the size of `alpha`."""
    alpha: Field
    """Extended silhouette [H,W]."""
    ends: tuple[End, ...]

    @property
    def object_mask(self) -> NDArray[np.bool_]:
        """Mask of the object [H,W], without the mirror images."""
        return self.rgba[..., 3] > 0.5

    @cached_property
    def body(self) -> NDArray[np.bool_] | None:
        """Mask of a vessel or drum [H,W]; None if there is none."""
        return upright_body(self.object_mask)

    def shorten(self) -> Continued:
        """Return the original image, without the continuations at the ends of cropped parts."""
        return Continued(self.rgba, self.rgba[..., 3], ())


def continue_silhouette(rgba: Field, padding: int) -> Continued:
    """Extend the silhouette of an image [H,W,4], whose border has `padding` pixels, beyond flat
    ends.
    """
    alpha, ends = rgba[..., 3], []
    standing = stands(alpha > 0.5) or upright_body(alpha > 0.5) is not None
    for sign in (1, -1):
        upright = alpha[::sign]
        rows = _arc(upright > 0.5)
        if not rows or not (standing or _rises(upright > 0.5, rows)):
            continue
        if sign < 0 and _is_parted(upright > 0.5, rows):
            continue  # there is, for example, a gap between two ears
        last = int(np.flatnonzero((upright > 0.5).any(axis=1))[-1])
        corner = last - rows + 1
        upper = upright[: corner + 1]
        lower = upper[::-1][: max(rows, min(corner, round(MIRRORED * len(rgba))))]
        lower = np.minimum(lower, upper[-1])  # the object does not become narrower near the end
        longer = np.concatenate([upper, lower, np.zeros_like(upper[:padding])])
        grown = max(0, len(longer) - len(alpha))
        rgba = np.pad(rgba[::sign], ((0, grown), (0, 0), (0, 0)))[::sign]
        alpha = np.pad(longer, ((0, len(rgba) - len(longer)), (0, 0)))[::sign]
        shift = grown if sign < 0 else 0
        ends = [
            replace(end, corner=end.corner + shift, outermost=end.outermost + shift) for end in ends
        ]
        inner, outer = (row + 0.5 if sign > 0 else len(rgba) - row - 1.5 for row in (corner, last))
        ends.append(End(inner, outer, sign, _divides(upright > 0.5, rows)))
    return Continued(rgba, alpha, tuple(ends))


def stands(solid: NDArray[np.bool_]) -> bool:
    """Whether the outline belongs to an upright cylinder.

    Such an outline has arcs at the top and the bottom. The arcs of a lying cylinder are at the left
    and right.
    """
    arcs = _arc(solid), _arc(solid[::-1])
    sides = _arc(solid.T), _arc(solid.T[::-1])
    return min(arcs) >= CURVED and min(sides) > 0 and max(sides) <= STRAIGHT


def _arc(solid: NDArray[np.bool_]) -> int:
    """Return the height of the lower end's arc in rows; 0 if the end is not flat."""
    solid = solid[::-1][np.flatnonzero(solid[::-1].any(axis=1))[0] :]
    widths = np.count_nonzero(solid, axis=1)
    for rows in range(1, (len(solid) - 2) // 2):
        width = widths[rows - 1]
        if rows > max(2, ARC * width):
            break
        wide = width >= FLAT * np.count_nonzero(solid.any(axis=0))
        if wide and width >= CORNERED * widths[2 * rows + 1]:
            return rows if rows <= max(2, ARC * _widest(solid[rows - 1])) else 0
    return 0


def _widest(row: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max())


def _divides(solid: NDArray[np.bool_], rows: int) -> bool:
    runs = _count_runs(solid, rows)
    return bool(runs.max() > runs[0])


def _is_parted(solid: NDArray[np.bool_], rows: int) -> bool:
    return bool(_count_runs(solid, rows).max() > 1)


def _count_runs(solid: NDArray[np.bool_], rows: int) -> NDArray[np.int64]:
    """Count the parts in each row of the lower end; shallow gaps do not separate parts."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    first = last - rows + 1
    depth = round(RAGGED * _widest(solid[first]))
    filled = sliding_window_view(solid[first - depth : last + 1], depth + 1, axis=0).any(axis=2)
    return np.count_nonzero(np.diff(filled.astype(int), prepend=0) > 0, axis=1)


def _rises(solid: NDArray[np.bool_], rows: int) -> bool:
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    row = solid[last - rows + 1]
    columns = solid[: last - rows + 2, row][::-1]
    heights = np.where(columns.all(axis=0), len(columns), (~columns).argmax(axis=0))
    return float(np.median(heights)) >= TALL * _widest(row)
