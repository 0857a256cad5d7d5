"""Splits two objects that touch, where the silhouette has a neck and the colours change.

A neck alone is not sufficient, because a person's head also sits on a neck. A change of colour
alone is not sufficient, because trousers and a shirt differ too. docs/lab/cutouts.md lists how
often a split is wrong.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.lab import number_bins, to_lab

Alpha = NDArray[np.uint8]
Solid = NDArray[np.bool_]
SIDE = 200
"""Longest side of the reduced image [pixels]."""
NECK = 0.4
"""Largest width of a neck, relative to the width of the thinner object."""
UNLIKE = 0.8
"""Smallest fraction by which the colour histograms of two objects differ."""
MOST = 4
SMALLEST = 0.25
"""Smallest area of each object, as a fraction of the area of both objects."""
BINS = (6, 16, 16)
"""Numbers of histogram bins for L, a and b."""


class Neck(NamedTuple):
    """The narrowest cross-section of a silhouette between two parts."""

    width: float
    """Width of the neck, relative to the width of the thinner part."""
    first: Solid
    """Mask [h,w] inside the first part."""
    second: Solid


def select_part(rgb: NDArray[np.uint8], alpha: Alpha, place: tuple[int, int]) -> Alpha:
    """Return the alpha [H,W] of the object nearest to a row and column, without objects that
    touch it.
    """
    for _ in range(MOST - 1):
        parts = split_touching(rgb, alpha)
        if parts is None:
            break
        nearest = min(parts, key=lambda part: _distance_to(part)[place])
        alpha = np.where(nearest, alpha, np.uint8(0))
    return alpha


def split_touching(rgb: NDArray[np.uint8], alpha: Alpha) -> tuple[Solid, Solid] | None:
    """Return masks [H,W] of two objects that touch; None for a single object.

    The alpha [H,W] must be one connected piece of a cut-out.
    """
    rows, columns = np.nonzero(alpha > 127)
    if not len(rows):
        return None
    scale = min(1.0, SIDE / (1 + max(np.ptp(rows), np.ptp(columns))))
    size = max(1, round(alpha.shape[1] * scale)), max(1, round(alpha.shape[0] * scale))
    solid = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA) > 127
    neck = _find_neck(solid)
    if neck is None or neck.width > NECK:
        return None
    nearer = _distance_to(neck.first) <= _distance_to(neck.second)
    first, second = solid & nearer, solid & ~nearer
    small = np.asarray(
        cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA), np.uint8
    )
    if _colour_difference(small, first, second) < UNLIKE:
        return None
    whole = cv2.resize(nearer.astype(np.uint8), alpha.shape[::-1]) > 0
    return (alpha > 0) & whole, (alpha > 0) & ~whole


def _find_neck(solid: Solid) -> Neck | None:
    depth = cv2.distanceTransform(np.pad(solid, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    best = None
    for level in np.arange(1.0, float(depth.max())):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((depth > level).astype(np.uint8))
        if len(stats) < 3:
            continue
        cores = [labels == k for k in 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:2]]
        nearer = _distance_to(cores[0]) <= _distance_to(cores[1])
        share = np.count_nonzero(solid & nearer) / np.count_nonzero(solid)
        width = level / min(float(depth[core].max()) for core in cores)
        if SMALLEST <= share <= 1 - SMALLEST and (best is None or width < best.width):
            best = Neck(float(width), cores[0], cores[1])
    return best


def _distance_to(core: Solid) -> NDArray[np.float32]:
    return np.asarray(cv2.distanceTransform((~core).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _colour_difference(rgb: NDArray[np.uint8], first: Solid, second: Solid) -> float:
    """Return the fraction of the histograms that two parts do not share."""
    kinds = number_bins(to_lab(rgb), BINS)
    counts = [np.bincount(kinds[part], minlength=math.prod(BINS)) for part in (first, second)]
    shares = [count / max(1, count.sum()) for count in counts]
    return float(1 - np.minimum(*shares).sum())
