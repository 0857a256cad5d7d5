"""What a cut-out tells: pieces, edges it reaches, outline nobody sees, colours found outside."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Solid = NDArray[np.bool_]
CRUMB = 0.01
"""Smallest piece that counts, in objects."""
NEAR = 0.035
"""So near to an edge of the picture it counts as touched, in shorter sides: GrabCut keeps 0.03."""
REACH = 0.02
"""Share of an edge that must be near."""
SIDE = 320
"""Longest side at which the outline is looked at, pixels."""
FAINT = 2.0
"""Change of colour that no eye takes for an edge, in units of CIE Lab."""
AROUND = 0.125
"""How far the surroundings of an object reach, in longest sides."""
BINS = (12, 24, 24)
"""Bins of L, a and b of a histogram of colours."""
LEAST, EXTENT = np.array([0, -100, -100]), np.array([100, 200, 200])
"""Range of L, a and b that the bins cover."""


def pieces(solid: Solid) -> int:
    """Parts that hang together, without crumbs."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(solid.astype(np.uint8), connectivity=8)
    return int((stats[1:, cv2.CC_STAT_AREA] >= CRUMB * solid.sum()).sum())


def touched(solid: Solid) -> tuple[str, ...]:
    """Edges of the picture that the object reaches, or nearly."""
    near = 1 + int(NEAR * min(solid.shape))
    edges = {
        "left": solid[:, :near].any(axis=1),
        "top": solid[:near].any(axis=0),
        "right": solid[:, -near:].any(axis=1),
        "bottom": solid[-near:].any(axis=0),
    }
    return tuple(name for name, edge in edges.items() if edge.mean() > REACH)


def unseen(rgb: NDArray[np.uint8], solid: Solid) -> float:
    """Share of the outline inside the picture where the picture [H,W,3] itself shows no edge."""
    lab, inside = _small(rgb, solid)
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    change = np.sqrt((across**2 + down**2).sum(axis=2))
    around = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_GRADIENT, around) > 0
    seen = cv2.dilate(change, around)[outline]
    return float((seen < FAINT).mean()) if len(seen) else 0.0


def alike(rgb: NDArray[np.uint8], solid: Solid) -> float:
    """Share of the surroundings whose colours are commoner in the object than around it."""
    lab, inside = _small(rgb, solid)
    away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    around = ~inside & (away <= AROUND * max(inside.shape))
    if not (inside.any() and around.any()):
        return 0.0
    bins = ((lab - LEAST) / EXTENT * BINS).astype(int)
    kinds = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(bins, 2, 0)), BINS, mode="clip"))
    commoner = _shares(kinds[inside]) > _shares(kinds[around])
    return float(commoner[kinds[around]].mean())


def _shares(kinds: NDArray[np.int_]) -> NDArray[np.float64]:
    """How common colours are, from their bins: neighbours of a colour count a little."""
    counts = np.bincount(kinds, minlength=math.prod(BINS)).reshape(BINS)
    return gaussian_filter(counts / len(kinds), 0.7, mode="constant").ravel()


def _small(rgb: NDArray[np.uint8], solid: Solid) -> tuple[NDArray[np.float32], Solid]:
    """Smoothed colours in CIE Lab [h,w,3] and the object [h,w], reduced to look at."""
    scale = min(1.0, SIDE / max(solid.shape))
    size = max(3, round(solid.shape[1] * scale)), max(3, round(solid.shape[0] * scale))
    small = cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(255 * solid.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    smooth = cv2.bilateralFilter(small, 5, 30, 3).astype(np.float32) / 255
    return np.asarray(cv2.cvtColor(smooth, cv2.COLOR_RGB2Lab), np.float32), mask > 127
