"""Recognises objects with straight vertical and horizontal edges: appliances, buildings, clothes.

A solid of revolution, in contrast, has few horizontal edges between its ends, and its brightness
changes from left to right.
"""

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.outlines import outline_of, solidity
from phy124.generators.relief.robust import fit_most

Field = NDArray[np.float64]
ROUGH = 1.5
"""Largest distance of the outline from straight edges [pixels]."""
SHORTEST = 20.0
"""Smallest length of a straight edge [pixels]; the object's longest side has 248 pixels."""
TILTED = 3.0
"""Largest angle between an edge and the vertical or the horizontal [degrees]."""
EITHER = 0.15
"""Smallest fraction of the outline that consists of vertical edges, and of horizontal edges."""
BOTH = 0.4
"""Smallest fraction of the outline that consists of vertical or horizontal edges."""
SOLID = 0.8
"""Smallest area, relative to the convex hull; hourglasses fill less of their hull."""
ACROSS, EXPLAINED = 0.15, 0.25
"""Smallest change of brightness from the axis of a cylinder to a side, relative to the mean
brightness, and smallest fraction of the brightness changes that a cylinder's shading explains.
"""
INNER = 0.92
"""Largest examined distance from the middle of a row, relative to half the row's length."""
NOISE = 0.01
"""Noise of the brightness, relative to the mean."""


def is_angular(rgba: Field) -> bool:
    """Whether an image [H,W,4] shows vertical and horizontal edges without a cylinder's shading."""
    object_mask = rgba[..., 3] > 0.5
    outline = outline_of(object_mask)
    corners = cv2.approxPolyDP(outline, ROUGH, closed=True)[:, 0].astype(np.float64)
    across, down = np.abs(np.roll(corners, -1, axis=0) - corners).T
    lengths, slope = np.hypot(across, down), np.tan(np.radians(TILTED))
    whole, straight = cv2.arcLength(outline, closed=True), lengths > SHORTEST
    vertical = lengths[straight & (across < slope * down)].sum() / whole
    horizontal = lengths[straight & (down < slope * across)].sum() / whole
    if min(vertical, horizontal) < EITHER or vertical + horizontal < BOTH:
        return False
    return solidity(object_mask) > SOLID and not is_shaded_across(rgba)


def is_shaded_across(rgba: Field) -> bool:
    """Whether an image [H,W,4] is shaded along the rows like an upright cylinder."""
    object_mask = rgba[..., 3] > 0.5
    rows, columns = np.nonzero(object_mask)
    every = np.arange(len(object_mask))
    low, high = (
        np.asarray(pick(columns, rows, every), np.float64)[rows]
        for pick in (scipy.ndimage.minimum, scipy.ndimage.maximum)
    )
    side = (2 * columns - low - high) / (high - low + 1)
    inner = np.abs(side) < INNER
    rows, side = rows[inner], side[inner]
    bright = rgba[..., :3].mean(axis=2)[object_mask][inner]
    ahead = np.sqrt(1 - side**2)
    changes, ahead = (
        values - np.asarray(scipy.ndimage.median(values, rows, every))[rows]
        for values in (bright, ahead)
    )
    known = np.column_stack([side, ahead, np.ones(len(side))])
    fitted = fit_most(known, changes, NOISE * float(bright.mean()))
    left = np.abs(changes - known @ fitted).sum()
    explained = left < (1 - EXPLAINED) * np.abs(changes - np.median(changes)).sum()
    return bool(explained and max(abs(fitted[0]), fitted[1]) > ACROSS * bright.mean())
