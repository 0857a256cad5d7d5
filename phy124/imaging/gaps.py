"""Opens gaps that a network fills, such as those between the spokes of a wheel.

A gap shows the background. If the background is plain, a gap therefore has the colour that the
surroundings of the object have at the same place, and a sharp edge. On white backgrounds nothing is
opened, because overexposed surfaces of white objects have the same colour.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.image import reduce_size
from phy124.imaging.lab import measure_change, to_lab
from phy124.imaging.matting import resize

Field = NDArray[np.float32]
SIDE = 640
"""Longest side of the reduced image [pixels]."""
AWAY, NEAR = 0.015, 0.15
"""Distances from the object between which the background is compared, relative to the image's
longest side.
"""
SMOOTH = 0.06
"""Smallest standard deviation of the filter that continues the background across the object,
relative to the image's longest side.
"""
REDUCED = 4
"""Factor by which the image is reduced for this filter."""
PLAIN = 3.0
"""Largest difference of a plain background from its continuation, for 90 % of the pixels [CIE Lab
units]; gaps may differ by the same amount.
"""
WHITE = 97.0
"""Lightness from which a background may be overexposed."""
SMALLEST = 0.02
"""Smallest area of a gap, as a fraction of the object's area; highlights are smaller."""
SHARP = 4.0
"""Smallest mean colour gradient along the edge of a gap [CIE Lab units per pixel]."""


def open_gaps(rgb: NDArray[np.uint8], coarse: Field) -> Field:
    """Remove gaps from a mask [h,w] of an object on a plain background in an image [H,W,3].

    The result with gaps has `SIDE` pixels along its longest side, or the size of the mask if this
    is larger.
    """
    size = reduce_size(rgb.shape, SIDE)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    lab, solid = to_lab(small), resize(coarse, size) > 0.5
    smooth = _blur(lab, 1.0)
    background = _continue_background(smooth, solid)
    if background is None:
        return coarse
    alike = np.linalg.norm(smooth - background, axis=2) < PLAIN
    alike &= background[..., 0] < WHITE
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        alike.astype(np.uint8), connectivity=4
    )
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    enclosed = np.setdiff1d(np.arange(1, count), rim)
    enclosed = enclosed[stats[enclosed, cv2.CC_STAT_AREA] > SMALLEST * np.count_nonzero(solid)]
    change = cv2.dilate(measure_change(lab), np.ones((3, 3)))
    gaps = np.zeros_like(solid)
    for number in enclosed:
        gap = (labels == number).astype(np.uint8)
        wide = cv2.dilate(gap, np.ones((3, 3), np.uint8)) > 0
        if change[wide & (gap == 0)].mean() > SHARP:
            gaps |= wide
    if not (gaps & solid).any():
        return coarse
    larger = size if max(coarse.shape) < max(size) else coarse.shape[::-1]
    return np.where(resize(gaps.astype(np.float32), larger) > 0.5, 0, resize(coarse, larger))


def _continue_background(lab: Field, solid: NDArray[np.bool_]) -> Field | None:
    """Return the background's colours [h,w,3], continued across the object; None if not plain.

    `lab` [h,w,3] are the colours of the image [CIE Lab], and `solid` [h,w] is the object's mask.
    """
    side = max(solid.shape)
    far = cv2.distanceTransform((~solid).astype(np.uint8), cv2.DIST_L2, 5) / side
    known = (far > AWAY).astype(np.float32)
    near = (far > AWAY) & (far < NEAR)
    if not near.any():
        return None
    # The filter's window, four deviations wide on each side, reaches the innermost pixels.
    deep = float(cv2.distanceTransform((known == 0).astype(np.uint8), cv2.DIST_L2, 5).max())
    deviation = max(SMOOTH * side, deep / 4)
    # The result is smooth, so it is computed on a reduced image, which is faster.
    size = known.shape[::-1]
    reduced = tuple(-(-length // REDUCED) for length in size)
    weight, total = (
        _blur(cv2.resize(values, reduced, interpolation=cv2.INTER_AREA), deviation / REDUCED)
        for values in (known, lab * known[..., None])
    )
    background = resize(np.asarray(total / np.maximum(weight, 1e-6)[..., None], np.float32), size)
    unlike = np.linalg.norm(lab - background, axis=2)[near]
    return background if np.quantile(unlike, 0.9) < PLAIN else None


def _blur(values: Field, deviation: float) -> Field:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), deviation), np.float32)
