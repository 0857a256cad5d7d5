"""Recognises cards, photographic prints and pages in any orientation.

A card has four straight edges, whereas a box seen obliquely shows six corners. An upright rectangle
is a card if the front is neither plain nor shaded like a cylinder.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.angular import TILTED, is_shaded_across
from phy124.generators.relief.boxes import rounded_polygon

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
SIDE = 128
"""Side of the straightened front [pixels]."""
INSET = 0.02
"""Width of the strip along the edges that is left out, relative to the edges' lengths."""
NARROWEST = 0.4
"""Smallest ratio of a card's edges; narrower objects may be sticks."""
FARTHER = 0.6
"""Smallest ratio of the lengths of opposite edges. The farther edge of a card appears shorter;
cones have smaller ratios.
"""


def is_card(rgba: Field, plain: bool) -> bool:
    """Whether an image [H,W,4] shows a card; upright rectangles with a `plain` front are boxes."""
    corners = rounded_polygon(rgba[..., 3] > 0.5, 4)
    if corners is None:
        return False
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T).reshape(2, 2)
    upright = np.abs(edges).min(axis=1) < np.tan(np.radians(TILTED)) * np.abs(edges).max(axis=1)
    if (plain and upright.all()) or _is_beaker(corners, upright):
        return False
    sides = lengths.mean(axis=0)
    if sides.min() < NARROWEST * sides.max() or (lengths.min(0) < FARTHER * lengths.max(0)).any():
        return False
    front = _straighten(rgba, corners)
    return not any(is_shaded_across(image) for image in (front, front.swapaxes(0, 1)))


def _is_beaker(corners: Field, upright: Mask) -> bool:
    """Whether an outline with horizontal ends is wider at the top, unlike a card, whose far end
    appears narrower.
    """
    if np.count_nonzero(upright) != 2:
        return False
    across = corners[np.argsort(corners[:, 1]), 0]
    return bool(np.ptp(across[:2]) > np.ptp(across[2:]))


def _straighten(rgba: Field, corners: Field) -> Field:
    """Return the front [SIDE,SIDE,4] between the corners [4,2]."""
    low, high = -INSET * SIDE, (1 + INSET) * SIDE
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    change = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
    front = cv2.warpPerspective(rgba[..., :3].astype(np.float32), change, (SIDE, SIDE))
    return np.dstack([front, np.ones((SIDE, SIDE))]).astype(np.float64)
