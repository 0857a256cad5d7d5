"""The flat ends of an object: the base on which it stands, and a flat top.

The lowest line of a standing object in a picture is straight or, with perspective, an arc between
two corners. Closing the solid there like at any other rim would give it a keel. So the silhouette
is inflated together with its mirror image below that line, and then cut off flat. Flat tops are
treated in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
MIRRORED = 0.25
"""Height of the mirror image, in picture heights; beyond, it does not affect the object."""
FLAT = 0.2
"""Smallest width of a flat end, as a fraction of the object's width."""
ARC = 0.15
"""Largest height of an end's arc, as a fraction of its width."""
CORNERED = 0.92
"""Smallest ratio of the width where the arc begins to that twice as high up; a ball has 0.74."""
TALL = 0.8
"""Smallest ratio of height to width above a flat end; flatter objects lie instead of standing."""


@dataclass(frozen=True)
class End:
    """A flat end, in rows of the picture from above."""

    corner: float
    """Row where the sides end and the arc begins; the silhouette is mirrored here."""
    outermost: float
    """Row where the arc ends."""
    sign: int
    """1: the bottom, -1: the top."""
    divided: bool = False
    """True for the outlines of several round feet instead of an arc."""

    def beyond(self, y: Field, by: float = 0.0) -> NDArray[np.bool_]:
        """Whether rows are beyond the end by more than a number of pixels."""
        return (y - self.outermost) * self.sign > by


@dataclass(frozen=True)
class Continued:
    """A picture whose silhouette continues beyond its flat ends."""

    rgba: Field
    """The picture [H,W,4], padded as `alpha` is."""
    alpha: Field
    """The silhouette with its mirror images [H,W]."""
    ends: tuple[End, ...]

    @property
    def object_mask(self) -> NDArray[np.bool_]:
        """Pixels of the object itself [H,W]."""
        return self.rgba[..., 3] > 0.5


def continue_silhouette(rgba: Field, padding: int) -> Continued:
    """Continue the silhouette of a picture [H,W,4] with a border of `padding` pixels."""
    alpha, ends = rgba[..., 3], []
    for sign in (1, -1):
        upright = alpha[::sign]
        rows = _arc(upright > 0.5)
        if not rows or not _rises(upright > 0.5, rows):
            continue
        if sign < 0 and _is_parted(upright > 0.5, rows):
            continue  # such as between two ears
        last = int(np.flatnonzero((upright > 0.5).any(axis=1))[-1])
        corner = last - rows + 1
        upper = upright[: corner + 1]
        lower = upper[::-1][: max(rows, min(corner, round(MIRRORED * len(rgba))))]
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


def _arc(solid: NDArray[np.bool_]) -> int:
    """Return the number of rows of the silhouette's [H,W] lowest end; 0: it has no flat end.

    The sides above a corner are steep, so the width hardly changes.
    """
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
    """Return the length of the longest run of a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max())


def _divides(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether the lowest end has a row with more runs than its first row."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    runs = np.count_nonzero(np.diff(solid[last - rows + 1 : last + 1].astype(int)) > 0, axis=1)
    return bool(runs.max() > runs[0])


def _is_parted(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether a row of the lowest end has several runs."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    return any(_widest(row) < np.count_nonzero(row) for row in solid[last - rows + 1 : last + 1])


def _rises(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether the object above the lowest end is at least about as high as wide."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    row = solid[last - rows + 1]
    columns = solid[: last - rows + 2, row][::-1]
    heights = np.where(columns.all(axis=0), len(columns), (~columns).argmax(axis=0))
    return float(np.median(heights)) >= TALL * _widest(row)
