"""Recognises flat objects by a border: coins, plates, signs, clocks and slices of fruit.

A border is a band along the outline that ends at a visible edge. Such edges are rare on round
objects, because patterns run across the outline and shading changes gradually. A dark line along
the outline of a drawing is not a border.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.back import thick_parts
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.outlines import outline_of

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
DISC = 0.9
"""Smallest area of the largest inscribed disc, relative to the area of a disc-shaped body."""
SECTORS = 120
"""Number of parts of equal length along the outline."""
BLUR = 1.0
"""Blur of the image, as a standard deviation [pixels]."""
NARROWEST, WIDEST = 5, 0.35
"""Smallest width of a border [pixels], and largest width, relative to the radius of the largest
inscribed disc. The object's longest side has 248 pixels.
"""
UNEVEN = 3
"""Largest difference of a border's width from the usual width [pixels]."""
AROUND = 0.88
"""Smallest fraction of the outline along which a border's edge is visible."""
KNOWN = 0.6
"""Smallest fraction of the sectors that have pixels at the border's distance from the outline."""
LEAST = 0.012
"""Smallest change of a colour across the edge [1 / pixel]."""
CLEAR = 3.0
"""Smallest ratio of the change across the edge to the usual change along the outline. Patterns
cause large changes along the outline.
"""
NOISE = 0.004
"""Noise of the changes along the outline [1 / pixel]."""
SHARP = 0.5
"""Largest change of the colour on both sides of the edge, relative to the change at the edge. The
ratio is larger for shading, which changes gradually.
"""
ALIKE = 0.7
"""Smallest fraction of the sectors in which the colour changes in the same direction as in the
sector a twelfth of the outline away. On a chessboard, the colours of neighbouring sectors change in
opposite directions.
"""
AWAY = (6, 10)
"""Range of distances from the edge in which the change is measured [pixels]."""
LINE, BLACK = 16, 0.15
"""Largest width [pixels] and brightness of a black line in a drawing."""
NARROW = 8
"""Largest width of a drawn line that is darker than the front inside [pixels]."""


@dataclass(frozen=True, eq=False)
class Bands:
    """Colours at each distance from the outline, for each sector of the outline."""

    seen: Mask
    """Whether the sector has pixels at this distance [D,SECTORS]."""
    across: Field
    """Mean change of the colour from the outline inwards [D,SECTORS,3], 1 / pixel."""
    along: Field
    """Usual change of the colour along the outline [SECTORS], 1 / pixel."""
    bright: Field
    """Median brightness at each distance [D]."""

    @classmethod
    def of(cls, rgba: Field) -> Bands:
        """Measure the colours along the outline of the object in an image [H,W,4]."""
        solid = rgba[..., 3] > 0.5
        outline = outline_of(solid)[:, 0]
        number = np.full(solid.shape, -1)
        number[outline[:, 1], outline[:, 0]] = np.arange(len(outline)) * SECTORS // len(outline)
        distance, near = nearest_of(number >= 0)
        depth = np.rint(distance[solid]).astype(int)
        deep, cells = depth.max() + 1, depth * SECTORS + number[near][solid]
        counts = np.bincount(cells, minlength=deep * SECTORS)

        def average(values: Field) -> Field:
            sums = np.bincount(cells, values[solid], len(counts))
            return (sums / np.maximum(counts, 1)).reshape(deep, SECTORS)

        down, right = np.gradient(distance)
        length = np.maximum(np.hypot(down, right), 1e-6)
        down, right = (down / length)[..., None], (right / length)[..., None]
        rows, columns = np.gradient(cv2.GaussianBlur(rgba[..., :3], (0, 0), BLUR), axis=(0, 1))
        inwards, sideways = rows * down + columns * right, rows * right - columns * down
        seen = counts.reshape(deep, SECTORS) > 0
        usual = np.sqrt(average((sideways**2).sum(axis=2)))
        usual = np.ma.masked_array(usual, ~seen)[
            UNEVEN + 1 : max(NARROWEST, int(WIDEST * deep)) + 1
        ]
        bright = scipy.ndimage.median(rgba[..., :3].mean(axis=2)[solid], depth, np.arange(deep))
        return cls(
            seen,
            np.stack([average(inwards[..., c]) for c in range(3)], axis=2),
            np.ma.median(usual, axis=0).filled(0.0),
            np.asarray(bright),
        )

    def is_border(self, width: int) -> bool:
        """Whether a border of about this width [pixels] ends at a sharp edge."""
        known, first = self.seen[width], width - UNEVEN
        if known.mean() < KNOWN:
            return False
        window = self.across[first : width + UNEVEN + 1, known]
        sizes = np.maximum(np.linalg.norm(window, axis=2), 1e-9)
        near, edge = sizes.max(axis=0), window[sizes.argmax(axis=0), np.arange(known.sum())]
        alike = (edge * np.roll(edge, SECTORS // 12, axis=0)).sum(axis=1) > 0
        return bool(
            np.quantile(near, 1 - AROUND) > LEAST
            and np.quantile(near / (self.along[known] + NOISE), 1 - AROUND) > CLEAR
            and self._changes_beyond(width, known, near) < SHARP
            and alike.mean() > ALIKE
            and not self._is_line(first + int(sizes.sum(axis=1).argmax()))
        )

    def _changes_beyond(self, width: int, known: Mask, near: Field) -> float:
        """Return how much the colour changes on both sides of an edge, relative to the change
        `near` [K] at the edge.
        """
        sides = [width + np.arange(*AWAY), width - np.arange(*AWAY)]
        sides = [self.across[rows[rows > UNEVEN]][:, known] for rows in sides]
        changes = [np.linalg.norm(side, axis=2).mean(axis=0) for side in sides if len(side)]
        return max(float(np.median(change / near)) for change in changes)

    def _is_line(self, width: int) -> bool:
        dark, inside = self.bright[2 : max(3, width - 1)].mean(), self.bright[width + UNEVEN]
        if width < NARROWEST:
            return True
        return dark < inside and (width < NARROW or (width < LINE and dark < BLACK))


def has_border(rgba: Field) -> bool:
    """Whether an image [H,W,4] shows an object with a border along the outline.

    Thin parts, such as the feet and bells of an alarm clock, may interrupt the border of a disc.
    """
    solid = rgba[..., 3] > 0.5
    body = thick_parts(solid)
    disc = np.pi * float(nearest_of(~body)[0].max()) ** 2
    if body is solid or disc < DISC * np.count_nonzero(body):
        return _is_bordered(rgba)
    return _is_bordered(rgba) or _is_bordered(np.dstack([rgba[..., :3], rgba[..., 3] * body]))


def _is_bordered(rgba: Field) -> bool:
    bands = Bands.of(rgba)
    widest = min(int(WIDEST * len(bands.seen)), len(bands.seen) - AWAY[1])
    return any(bands.is_border(width) for width in range(NARROWEST + 1, widest))
