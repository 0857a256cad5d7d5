"""Samples a grey image that a user painted over an object's image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.imaging.image import open_mask

Crop = tuple[float, float, float, float]
WHOLE: Crop = (0.0, 0.0, 1.0, 1.0)
"""Left, top, right and bottom of the object in its image, as fractions of width and height."""


@dataclass(frozen=True)
class Canvas:
    """The front of an object, over which images are painted."""

    axes: NDArray[np.float64]
    """Rotation [3,3] from the object that is upright and faces +x to the object in the scene."""
    low: NDArray[np.float64]
    """Lowest corner of the upright object's box [3], m."""
    high: NDArray[np.float64]
    """Highest corner of the upright object's box [3], m."""
    crop: Crop
    """Position of the object within the image."""

    @classmethod
    def of(cls, x: NDArray, crop: Crop = WHOLE, axes: NDArray | None = None) -> Canvas:
        """Return the canvas of an object with the points x [P,3], m."""
        axes = np.eye(3) if axes is None else axes
        upright = x @ axes
        return cls(axes, upright.min(axis=0), upright.max(axis=0), crop)


def sample_brightness(x: NDArray, path: Path, canvas: Canvas, *, field: str) -> NDArray[np.float64]:
    """Return the brightness [P] at points seen from the front: 0 is black, 1 is white.

    Args:
        x: Points at rest in the scene [P,3], m.
        path: The image; its colours are converted to grey.
        canvas: The object over which the image is painted.
        field: Name of the image in messages.

    Raises:
        InputError: If the image cannot be read.
    """
    opened = open_mask(path, field=field, minimum=1)
    grey = np.asarray(opened.convert("L"), dtype=np.float64) / 255
    x, low, high = x @ canvas.axes, canvas.low, canvas.high
    across = (x[:, 1] - low[1]) / max(high[1] - low[1], 1e-12)
    down = (high[2] - x[:, 2]) / max(high[2] - low[2], 1e-12)
    left, top, right, bottom = canvas.crop
    column = (left + across * (right - left)) * grey.shape[1]
    row = (top + down * (bottom - top)) * grey.shape[0]
    i = np.clip(row.astype(int), 0, grey.shape[0] - 1)
    return grey[i, np.clip(column.astype(int), 0, grey.shape[1] - 1)]


def crop_of(cutout: Image.Image) -> Crop:
    """Return the position of the object within an RGBA cut-out."""
    opaque = np.asarray(cutout.getchannel("A")) > 127
    rows, columns = np.flatnonzero(opaque.any(axis=1)), np.flatnonzero(opaque.any(axis=0))
    if not len(rows):
        return WHOLE
    height, width = opaque.shape
    left, right = columns[0] / width, (columns[-1] + 1) / width
    return float(left), rows[0] / height, float(right), (rows[-1] + 1) / height
