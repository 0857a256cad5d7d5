"""Grows sets of voxels."""

import cv2
import numpy as np
from numpy.typing import NDArray


def dilate(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Return the voxels [X,Y,Z] whose distance from a mask is at most `radius` along each axis."""
    # OpenCV treats the last axis as image channels and is many times faster than SciPy.
    side, shape = 2 * radius + 1, mask.shape
    grown = cv2.dilate(np.ascontiguousarray(mask).view(np.uint8), np.ones((side, side), np.uint8))
    grown = cv2.dilate(grown.reshape(-1, shape[2]), np.ones((1, side), np.uint8))
    return grown.reshape(shape).view(bool)
