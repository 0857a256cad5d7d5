"""Measures the plausibility of a mask by its pieces, position, outline and colours."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.image import reduce_size
from phy124.imaging.lab import measure_change, number_bins, to_lab

Solid = NDArray[np.bool_]
SMALLEST_PIECE = 0.01
"""Smallest area of a piece that is counted, as a fraction of the object's area."""
NEAR = 0.035
"""An object is near an image edge within this distance, relative to the image's shorter side.

GrabCut's masks always keep a distance of at least 0.03 from the image edges.
"""
REACH = 0.02
"""An object touches an image edge if it is near at least this fraction of the edge."""
SIDE = 320
FAINT = 2.0
"""Smallest colour gradient at an edge, in CIE Lab units per pixel."""
WIDE = 2.0
"""Half the width of a soft edge [pixels]."""
FITTED = 640
"""If the longest side of an image exceeds this [pixels], soft edges are wider than `WIDE` by the
same factor.
"""
HALF = 25
AROUND = 0.125
"""Width of the examined strip around an object, relative to the image's longest side."""
BINS = (12, 24, 24)
"""Numbers of histogram bins for L, a and b."""
SIMILAR, ONE = cv2.getGaussianKernel(7, 0.7), np.ones(1)


def count_pieces(solid: Solid) -> int:
    """Count the connected pieces with at least the fraction `SMALLEST_PIECE` of the total area."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(solid.astype(np.uint8), connectivity=8)
    return int((stats[1:, cv2.CC_STAT_AREA] >= SMALLEST_PIECE * solid.sum()).sum())


def find_touched_edges(solid: Solid) -> tuple[str, ...]:
    """Return the names of the image edges that the object reaches or nearly reaches."""
    near = 1 + int(NEAR * min(solid.shape))
    edges = {
        "left": solid[:, :near].any(axis=1),
        "top": solid[:near].any(axis=0),
        "right": solid[:, -near:].any(axis=1),
        "bottom": solid[-near:].any(axis=0),
    }
    return tuple(name for name, edge in edges.items() if edge.mean() > REACH)


def measure_unseen(rgb: NDArray[np.uint8], solid: Solid) -> float:
    """Return the fraction of the outline along which the image [H,W,3] shows no edge."""
    lab, inside = _reduce(rgb, solid)
    around = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_GRADIENT, around) > 0
    seen = cv2.dilate(measure_change(lab), around)[outline]
    return float((seen < FAINT).mean()) if len(seen) else 0.0


def measure_alike(rgb: NDArray[np.uint8], solid: Solid) -> float:
    """Return the fraction of outside pixels whose colour is more common inside the object."""
    lab, inside = _reduce(rgb, solid)
    away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    around = ~inside & (away <= AROUND * max(inside.shape))
    if not (inside.any() and around.any()):
        return 0.0
    kinds = number_bins(lab, BINS)
    commoner = _colour_fractions(kinds[inside]) > _colour_fractions(kinds[around])
    return float(commoner[kinds[around]].mean())


def measure_undecided(alpha: NDArray[np.uint8]) -> float:
    """Return the half-transparent area away from the outline, divided by the object's area.

    Within a few pixels of the outline, half transparency is usual. Farther away from the outline,
    half transparency shows that the network was uncertain.
    """
    inside = (alpha > 127).astype(np.uint8)
    reach = WIDE * max(1.0, max(alpha.shape) / FITTED)
    away = np.maximum(*(cv2.distanceTransform(m, cv2.DIST_L2, 3) for m in (inside, 1 - inside)))
    half = (alpha > HALF) & (alpha < 255 - HALF)
    return float((half & (away > reach)).sum() / max(1, int(inside.sum())))


def _colour_fractions(kinds: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return a smoothed histogram whose sum is 1."""
    common = np.bincount(kinds, minlength=math.prod(BINS)) / len(kinds)
    for bins in BINS:
        # Smooth along the first axis, then make it the last axis.
        rows = np.ascontiguousarray(common.reshape(bins, -1).T)
        smooth = cv2.sepFilter2D(rows, -1, SIMILAR, ONE, borderType=cv2.BORDER_CONSTANT)
        common = np.asarray(smooth, np.float64).ravel()
    return common


def _reduce(rgb: NDArray[np.uint8], solid: Solid) -> tuple[NDArray[np.float32], Solid]:
    """Return smoothed CIE Lab colours [h,w,3] and a mask [h,w]."""
    size = reduce_size(solid.shape, SIDE, 3)
    small = cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(255 * solid.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    return to_lab(np.asarray(cv2.bilateralFilter(small, 5, 30, 3), np.uint8)), mask > 127
