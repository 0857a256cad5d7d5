"""Selects one of several objects in an image: the largest object, or the object at a point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.imaging.silhouette import find_touched_edges

Alpha = NDArray[np.uint8]
Point = tuple[float, float]
"""Distances from the left and the top, as fractions of the image's width and height."""
Box = tuple[int, int, int, int]
"""Left, top, right and bottom [pixels]."""
GAP = 0.01
"""Largest gap between pieces of the same object, relative to the image's longest side."""
COUNTED = 0.05
"""Objects with less than this fraction of the largest object's area are ignored."""
NEAR = 0.02
"""Largest distance of a point from its object, relative to the image's longest side."""
WINDOWS = (0.7, 0.45, 0.3, 0.15, 0.08)
"""Sides of the search windows, relative to the image's longest side."""
MINIMUM = 0.02
"""Smallest fraction of a search window that an object must cover."""


class Objects(NamedTuple):
    """The objects of an alpha channel, numbered from 1."""

    nearest: NDArray[np.int32]
    """Number of the nearest object, for each pixel [H,W]."""
    areas: NDArray[np.int_]

    @classmethod
    def of(cls, alpha: Alpha) -> Objects:
        """Separate the objects of an alpha [H,W], which must be opaque somewhere."""
        solid = alpha > 127
        reach = 2 * max(1, round(GAP * max(alpha.shape) / 2)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
        apart = 1 - cv2.dilate(solid.astype(np.uint8), disc)
        labels = cv2.distanceTransformWithLabels(
            apart, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_CCOMP
        )[1]
        nearest = np.asarray(labels, np.int32)
        return cls(nearest, np.bincount(nearest[solid], minlength=nearest.max() + 1))

    @property
    def number(self) -> int:
        """Number of objects, without small ones."""
        return int((self.areas >= COUNTED * self.areas.max()).sum())


def keep_largest(alpha: Alpha) -> tuple[Alpha, int]:
    """Return the alpha [H,W] of the largest object, and the number of objects."""
    if not (alpha > 127).any():
        return alpha, 0
    objects = Objects.of(alpha)
    return np.where(objects.nearest == objects.areas.argmax(), alpha, np.uint8(0)), objects.number


def select_object(alpha: Alpha, point: Point) -> Alpha | None:
    """Return the alpha [H,W] of the object at a point, or None."""
    solid = (alpha > 127).astype(np.uint8)
    away = cv2.distanceTransform(1 - solid, cv2.DIST_L2, 5)
    place = pixel_at(point, (alpha.shape[1], alpha.shape[0]))
    if not solid.any() or away[place] > NEAR * max(alpha.shape):
        return None
    nearest = Objects.of(alpha).nearest
    return np.where(nearest == nearest[place], alpha, np.uint8(0))


def search_around(
    image: Image.Image,
    point: Point,
    find: Callable[[Image.Image], Alpha],
    sides: tuple[float, ...] = WINDOWS,
) -> Alpha | None:
    """Search windows around a point for an object that the segmentation missed.

    Args:
        image: The whole image.
        point: A point on the object.
        find: Segments the object of a window; returns the alpha of the window.
        sides: Sides of the windows, relative to the image's longest side.

    Returns:
        The alpha [H,W] of the object that touches the fewest edges of its window, or None.
    """
    best, fewest = None, 5
    for box in _windows_around(image.size, point, sides):
        left, top, right, bottom = box
        inside = pixel_at(point, image.size)
        place = (inside[1] - left + 0.5) / (right - left), (inside[0] - top + 0.5) / (bottom - top)
        alpha = select_object(find(image.crop(box)), place)
        if alpha is None or np.mean(alpha > 127) < MINIMUM:
            continue
        edges = len(find_touched_edges(alpha > 127))
        if edges < fewest:
            best, fewest = np.zeros(image.size[::-1], np.uint8), edges
            best[top:bottom, left:right] = alpha
        if not edges:
            break
    return best


def _windows_around(size: tuple[int, int], point: Point, sides: tuple[float, ...]) -> Iterator[Box]:
    row, column = pixel_at(point, size)
    for fraction in sides:
        side = round(fraction * max(size))
        width, height = min(side, size[0]), min(side, size[1])
        left = min(max(column - width // 2, 0), size[0] - width)
        top = min(max(row - height // 2, 0), size[1] - height)
        yield left, top, left + width, top + height


def pixel_at(point: Point, size: tuple[int, int]) -> tuple[int, int]:
    """Return the row and column of a point in an image of the size (W, H)."""
    column, row = (min(int(f * n), n - 1) for f, n in zip(point, size, strict=True))
    return row, column
