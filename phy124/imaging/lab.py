"""Converts colours to CIE Lab 1976, in which distances approximate perceived differences.

OpenCV's conversion to Lab is not used, because it first spends 0.07 s on tables.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

WHITE = np.array([0.950456, 1.0, 1.088754], np.float32)
"""X, Y and Z of the white point D65."""
LINEAR = 0.008856
"""CIE's lightness is linear up to this luminance, relative to white."""


def to_lab(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Convert sRGB colours [H,W,3] to L, a and b [H,W,3], following IEC 61966-2-1 and CIE 15."""
    xyz = cv2.cvtColor(LIGHT[rgb], cv2.COLOR_RGB2XYZ) / WHITE
    root = np.where(xyz > LINEAR, np.cbrt(xyz), np.float32(7.787) * xyz + np.float32(16 / 116))
    x, y, z = np.moveaxis(root, 2, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=2)


def measure_change(lab: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the gradient of colours [H,W,3] in each pixel [H,W], in CIE Lab units per pixel."""
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    return np.sqrt((across**2 + down**2).sum(axis=2))


def number_bins(lab: NDArray[np.float32], bins: tuple[int, int, int]) -> NDArray[np.intp]:
    """Return each pixel's histogram bin [H,W]; `bins` are the numbers of bins of L, a and b."""
    places = ((lab - [0, -100, -100]) / [100, 200, 200] * bins).astype(int)
    return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(places, 2, 0)), bins, mode="clip"))


def _linear_light() -> NDArray[np.float32]:
    value = np.arange(256) / 255
    curved = ((value + 0.055) / 1.055) ** 2.4
    return np.where(value <= 0.04045, value / 12.92, curved).astype(np.float32)


LIGHT = _linear_light()
"""Linear light 0..1 of each byte value [256]."""
