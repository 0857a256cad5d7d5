"""Two objects that touch: parted where the silhouette has a neck and the colours change.

A neck alone is no evidence (a head on shoulders, a hand with what it holds), nor are colours alone
(trousers and shirt): both are asked for, and that neither part is a mere appendage. Even so a sail
looks like an object of its own: how often it is right is in docs/results/cutouts.md.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.lab import to_lab

Alpha = NDArray[np.uint8]
Solid = NDArray[np.bool_]
SIDE = 200
"""Longest side of the silhouette while it is examined, pixels."""
NECK = 0.4
"""Width of the neck to that of the thinner part, at most."""
UNLIKE = 0.8
"""Fraction of the colours that both parts do not share, at least."""
MOST = 4
"""Objects in a row that are parted from each other."""
SMALLEST = 0.25
"""Area of the smaller part, of both, at least."""
BINS = np.array([6, 16, 16])
"""Of L, a and b."""
LOW, RANGE = np.array([0, -100, -100]), np.array([100, 200, 200])
"""Lowest values of L, a and b, and the ranges that the bins cover."""


class Neck(NamedTuple):
    """Where a silhouette is narrowest between two parts."""

    width: float
    """Relative to the thinner part."""
    first: Solid
    """The cores of both parts [h,w], beyond which the neck lies."""
    second: Solid


def part_at(rgb: NDArray[np.uint8], alpha: Alpha, place: tuple[int, int]) -> Alpha:
    """The alpha [H,W] of the touching object at a row and column alone; all of it if it is one."""
    for _ in range(MOST - 1):
        parts = parted(rgb, alpha)
        if parts is None:
            break
        alpha = np.where(parts[0] if parts[0][place] else parts[1], alpha, np.uint8(0))
    return alpha


def parted(rgb: NDArray[np.uint8], alpha: Alpha) -> tuple[Solid, Solid] | None:
    """Which pixels [H,W] belong to either of two touching objects; None: it is one.

    Args:
        rgb: The picture [H,W,3].
        alpha: Of one connected object [H,W].
    """
    rows, columns = np.nonzero(alpha > 127)
    if not len(rows):
        return None
    scale = min(1.0, SIDE / (1 + max(np.ptp(rows), np.ptp(columns))))
    size = max(1, round(alpha.shape[1] * scale)), max(1, round(alpha.shape[0] * scale))
    solid = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA) > 127
    neck = _neck(solid)
    if neck is None or neck.width > NECK:
        return None
    nearer = _away(neck.first) <= _away(neck.second)
    one, other = solid & nearer, solid & ~nearer
    small = np.asarray(
        cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA), np.uint8
    )
    if _unlike(small, one, other) < UNLIKE:
        return None
    whole = cv2.resize(nearer.astype(np.uint8), alpha.shape[::-1]) > 0
    return (alpha > 0) & whole, (alpha > 0) & ~whole


def _neck(solid: Solid) -> Neck | None:
    """The narrowest neck of a silhouette [h,w] with a large part on either side."""
    depth = cv2.distanceTransform(np.pad(solid, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    best = None
    for level in np.arange(1.0, float(depth.max())):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((depth > level).astype(np.uint8))
        if len(stats) < 3:
            continue
        cores = [labels == k for k in 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:2]]
        nearer = _away(cores[0]) <= _away(cores[1])
        share = np.count_nonzero(solid & nearer) / np.count_nonzero(solid)
        width = level / min(float(depth[core].max()) for core in cores)
        if SMALLEST <= share <= 1 - SMALLEST and (best is None or width < best.width):
            best = Neck(float(width), cores[0], cores[1])
    return best


def _away(core: Solid) -> NDArray[np.float32]:
    return np.asarray(cv2.distanceTransform((~core).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _unlike(rgb: NDArray[np.uint8], one: Solid, other: Solid) -> float:
    """Fraction of the colours of two parts that they do not share."""
    lab = to_lab(rgb)
    bins = np.clip(((lab - LOW) / RANGE * BINS).astype(int), 0, BINS - 1)
    kinds = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(bins, 2, 0)), tuple(BINS)))
    counts = [np.bincount(kinds[part], minlength=int(BINS.prod())) for part in (one, other)]
    shares = [count / max(1, count.sum()) for count in counts]
    return float(1 - np.minimum(*shares).sum())
