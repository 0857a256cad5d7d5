"""The flat ends of an object: what it stands on, and where it is cut off.

Where an object stands, its lowest line in the picture is straight or, with perspective, an arc
between two corners; closing the solid there like at any other rim would give it a keel. So the
silhouette is inflated together with its mirror image below that line, as if it continued, and then
cut off flat. The same holds for its top.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
MIRRORED = 0.25
"""Height of the mirror image, in picture heights; farther away it no longer affects the object."""
FLAT = 0.2
"""Fraction of the object's width that a flat end must have."""
ARC = 0.15
"""Largest height of the arc in which it may end, as a fraction of its width."""
CORNERED = 0.92
"""Width where the arc begins to that twice as high up, at least; a ball has 0.74."""
TALL = 0.8
"""Height of what rises from a flat end to its width, at least: less is a thing that lies there."""


@dataclass(frozen=True)
class End:
    """One flat end, in rows of the picture from above."""

    corner: float
    """Where the sides end and the arc begins; the mirror image is taken here."""
    outermost: float
    """Where the arc ends."""
    sign: int
    """1: the bottom, -1: the top."""
    divided: bool = False
    """Whether it is no arc but the outlines of several round feet."""

    def beyond(self, y: Field, by: float = 0.0) -> NDArray[np.bool_]:
        """Which rows lie farther out than the end, by so many pixels."""
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
    def own(self) -> NDArray[np.bool_]:
        """Pixels of the object itself [H,W]."""
        return self.rgba[..., 3] > 0.5


def continued(rgba: Field, padding: int) -> Continued:
    """The picture [H,W,4], whose border of `padding` pixels is transparent, with its ends."""
    alpha, ends = rgba[..., 3], []
    for sign in (1, -1):
        upright = alpha[::sign]
        rows = _arc(upright > 0.5)
        if not rows or not _rises(upright > 0.5, rows):
            continue
        if sign < 0 and _parted(upright > 0.5, rows):
            continue  # between two ears, say
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
    """In how many rows the silhouette [H,W] reaches the corners of its lowest end; 0: it has none.

    Below a corner the sides are steep, so that the width hardly changes farther up.
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
    """Length of the longest run of a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max())


def _divides(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether the lowest end has more runs somewhere than where it begins."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    runs = np.count_nonzero(np.diff(solid[last - rows + 1 : last + 1].astype(int)) > 0, axis=1)
    return bool(runs.max() > runs[0])


def _parted(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether a row of the lowest end has several runs."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    return any(_widest(row) < np.count_nonzero(row) for row in solid[last - rows + 1 : last + 1])


def _rises(solid: NDArray[np.bool_], rows: int) -> bool:
    """Whether what stands on the lowest end is at least about as high as wide."""
    last = int(np.flatnonzero(solid.any(axis=1))[-1])
    row = solid[last - rows + 1]
    columns = solid[: last - rows + 2, row][::-1]
    heights = np.where(columns.all(axis=0), len(columns), (~columns).argmax(axis=0))
    return float(np.median(heights)) >= TALL * _widest(row)
