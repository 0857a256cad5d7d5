"""Measures the outline of a silhouette."""

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def outline_of(object_mask: Mask) -> NDArray[np.int32]:
    """Return the pixels [N,1,2] of a mask's longest outer outline, column first."""
    outlines, _ = cv2.findContours(
        object_mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    return np.asarray(max(outlines, key=len), np.int32)


def solidity(object_mask: Mask) -> float:
    """Return the silhouette's area, divided by the area of its convex hull."""
    hull = cv2.convexHull(outline_of(object_mask))
    return float(np.count_nonzero(object_mask) / max(cv2.contourArea(hull), 1.0))
