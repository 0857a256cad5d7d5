"""Detects signs that an object is hollow: a rim seen from above, or a gap as in a handle.

If a cup, bowl or pot is seen slightly from above, its rim appears as an ellipse. The back half of
the ellipse is the top of the outline, and the front half is an edge inside the outline. Below the
rim, there is a wall. In 195 pictures (renderings of known objects, cut-outs and the examples), 17
of 18 rims are detected, and there are 4 false detections: two of a cake, which looks like a full
tin, one of an armchair, and one of a car. A rim in front of a wide saucer is not detected, because
its ends do not lie on the outline.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.lab import measure_change, to_lab

Solid = NDArray[np.bool_]
GAP = 0.03
"""Smallest area of a gap in the outline, as a fraction of the object's area."""
SIDE = 200
"""Longest side of the reduced object [pixels]."""
MARGIN = 3
UPPER = 0.5
"""Largest distance of a rim's centre from the object's top, relative to the object's height."""
WIDE = 0.2
"""Smallest width of a rim, relative to the object's longest side."""
ASPECTS = (0.08, 0.6)
"""Allowed ratios of a rim's height to its width."""
FIT = 0.025
"""Largest mean distance of the outline from the rim's back half, relative to half the rim's width.
"""
FRONT = 0.95
"""The image must have an edge along at least this fraction of the rim's front half."""
EDGE = 2.0
"""Smallest colour gradient at an edge, in CIE Lab units per pixel."""
ACROSS = np.linspace(-0.85, 0.85, 41)
"""Positions across a rim at which the outline is sampled, relative to half the rim's width."""
WALL, BELOW = 0.15, 0.4
"""Smallest height of the wall below a rim, and height at which its width is measured, relative to
half the rim's width.
"""
CORE = 0.6
"""Half the width of the part of the wall that has no gaps, relative to half the rim's width."""
WIDER = 1.3
"""Largest width of the wall, relative to the rim's width; one side, with a handle, may be wider."""
NEARER = (0.9, 1.0, 1.1, 1.2)
"""Heights that are tried for the rim's front half, relative to the back half. Perspective enlarges
the front half.
"""


def find_hollow(rgb: NDArray[np.uint8], solid: Solid) -> Iterator[str]:
    """Yield notes if the object of an image [H,W,3] seems to be hollow or to have a handle."""
    guess = "one picture does not show the inside, so the object is filled."
    if has_rim(rgb, solid):
        yield f"This may be a hollow object, because its rim is seen from above: {guess}"
    elif has_gap(solid):
        gap = "The outline has a gap, like that inside a handle or a ring."
        yield f"{gap} If the object is hollow: {guess}"


def has_gap(solid: Solid) -> bool:
    """Whether the silhouette encloses a part of the background."""
    _, _, stats, _ = cv2.connectedComponentsWithStats((~solid).astype(np.uint8), connectivity=4)
    left, top, width, height, area = stats[1:].T
    inner = (left > 0) & (top > 0)
    inner &= (left + width < solid.shape[1]) & (top + height < solid.shape[0])
    return bool((area[inner] > GAP * solid.sum()).any())


def has_rim(rgb: NDArray[np.uint8], solid: Solid) -> bool:
    """Whether the top of the object is a rim, which appears as an ellipse from above."""
    edges, mask = _find_edges(rgb, solid)
    top, arc = mask.argmax(axis=0), np.sqrt(1 - ACROSS**2)
    for centre in range(MARGIN + 1, int(UPPER * len(mask))):
        row = np.flatnonzero(mask[centre])
        if len(row) < WIDE * SIDE:
            continue
        half = (row[-1] - row[0]) / 2
        x = np.round(row[0] + half * (1 + ACROSS)).astype(int)
        rise = centre - top[x]
        back = float(np.median(rise / arc))
        if not ASPECTS[0] * half < back < ASPECTS[1] * half:
            continue
        if np.abs(rise - back * arc).mean() > FIT * half:
            continue
        for nearer in NEARER:
            y = np.round(centre + nearer * back * arc).astype(int)
            if y.max() >= len(mask) or edges[y, x].mean() < FRONT:
                continue
            if _is_above_wall(mask, int(y.max()), float(row.mean()), half):
                return True
    return False


def _is_above_wall(mask: Solid, front: int, middle: float, half: float) -> bool:
    """Whether a wall without gaps is below the row `front` of a rim, and is hardly wider than it.

    Plates have no wall, stools have legs, and roofs of cars and crowns of hats become wider.
    """
    below = mask[front : front + max(2, round(BELOW * half))]
    if not below[: round(WALL * half), round(middle)].all():
        return False
    core = below[:, round(middle - CORE * half) : round(middle + CORE * half)]
    if (np.abs(np.diff(np.pad(core, ((0, 0), (1, 1))).astype(int), axis=1)).sum(axis=1) > 2).any():
        return False
    last = np.flatnonzero(below[-1])
    wider = WIDER * half
    return not len(last) or middle - last[0] <= wider or last[-1] - middle <= wider


def _find_edges(rgb: NDArray[np.uint8], solid: Solid) -> tuple[Solid, Solid]:
    """Return edges inside the object and the object's mask, both reduced to `SIDE` pixels."""
    ys, xs = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    box = np.s_[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
    rgb, solid = np.ascontiguousarray(rgb[box]), solid[box]
    scale = SIDE / max(solid.shape)
    size = [max(round(side * scale), 1) for side in solid.shape[::-1]]
    small: NDArray[Any] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    lab = to_lab(small)
    shown = cv2.resize(solid.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    mask = np.pad(shown > 127, MARGIN)
    lab = np.pad(lab, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), mode="edge")
    change = cv2.dilate(measure_change(lab), np.ones((3, 3)))
    inside = cv2.erode(mask.astype(np.uint8), np.ones((5, 5))) > 0
    return (change > EDGE) & inside, mask
