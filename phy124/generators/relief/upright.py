"""Recognises vessels and drums, which stand upright, although they may be wider than high.

Most convex objects that are wider than high lie on a side. A drum has straight sides, and the lower
edge is half of an ellipse. A vessel is widest at the rim, and becomes narrower towards the foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
CENTRED, EVERY = 0.04, 0.97
"""In the outline of an upright object, at least the fraction `EVERY` of the rows is centred and has
no gaps. The centre of a centred row is nearer to the axis than `CENTRED`, relative to half the
largest width.
"""
LEAN = 0.04
"""Largest slope of the axis in the image. In a perspective image, an object far from the centre
leans.
"""
ELLIPTIC = 0.03
"""Largest root mean square distance of an arc from half of an ellipse, relative to half the
ellipse's width.
"""
LOWEST_VIEW, HIGHEST_VIEW = 0.08, 0.7
"""Limits of an ellipse's ratio of height to width, for a circle seen from above. Arcs of a ball
have larger ratios.
"""
WALL = 0.3
"""Smallest height of a drum between the arcs, relative to half the width."""
MORE = 0.1
"""A drum's upper arc may be higher than the lower arc by at most this amount, relative to half the
width. If a drum is seen from above, the upper circle appears flatter.
"""
FULL = 0.97
"""Smallest width of the rim, relative to the largest width."""
FLAT_RIM, LOW_RIM = 0.15, 0.5
"""Largest height of the part of a vessel's outline above the rim, relative to the whole height.

`LOW_RIM` applies if the part above the rim is half of an ellipse. If the lower part is half of an
ellipse as well, the outline is that of an egg.
"""
EGG = 0.9
"""An outline is that of an egg if its upper and lower arcs together take more than this fraction of
the height.
"""
NARROWER = 0.75
"""Largest width near a vessel's foot, relative to the largest width; a drum is wider."""
FOOT = 0.12
"""Height at which the width near the foot is measured, relative to the object's height."""
WIDENING = 0.03
"""Largest increase of a vessel's half width below the rim, relative to the largest half width."""
UPPER = 0.22
"""In an outline with a tip, such as a shield, the rim is in this uppermost fraction of the height.
"""
TIP_HEIGHT = 0.1
"""Height above the tip at which the width near the tip is measured, relative to the object's
height.
"""
TAPERED = 0.46
"""Largest width near a tip (at the height `TIP_HEIGHT`), relative to the largest width."""
HIGHER = 0.6
"""Smallest ratio of height to width of an outline with a tip; bowls without a foot are lower."""
STEP = 0.12
"""Within the height `SPAN`, a vessel's half width decreases by at most this fraction of the largest
half width.
"""
SPAN = 0.03
"""Height within which `STEP` limits the decrease, relative to the object's height. Sleeves end more
abruptly.
"""
THIN = 0.4
"""Largest thickness of a handle, relative to the thickest part."""
REACH = 0.05
"""Smallest length of a handle, relative to the object's size."""
TIP = 0.2
"""Length of a protruding part's tip, relative to the part."""
POINTED = 0.3
"""A protruding part is a rim instead of a handle if its tip is lower than this, relative to the
part's height.
"""
LARGEST = 0.06
"""Largest area of a bulge at one side of a vessel, relative to the silhouette. The bulges of mugs
have 0.04, and the wing of a plane 0.1.
"""
BULGE, TRIED = 0.4, 40
"""At least the fraction `BULGE` of the rows is not widened by a bulge at one side. `TRIED` is the
number of rows from which the axis is chosen.
"""
FEWEST = 16
BELOW = 0.08
"""At least this fraction of the object's height is below a handle. Below brims and feet, there is
nothing.
"""


def upright_body(object_mask: Mask) -> Mask | None:
    """Return the vessel or drum in a silhouette [H,W], without handles, or None."""
    if not object_mask.any():
        return None
    for body in (_without_handles(object_mask), object_mask, _without_bulge(object_mask)):
        profile = None if body is None else Profile.of(body)
        if profile and profile.symmetric and (profile.is_drum() or profile.is_vessel()):
            return body
    return None


@dataclass(frozen=True, eq=False)
class Profile:
    """Half the width of each row of a silhouette, from the top to the bottom."""

    half: Field
    """Half widths [H], pixels."""
    rows: Field
    """Rows [H], counted from the top of the image."""
    axis: float
    """Column of the axis."""
    middle: Field
    """Column of the centre of each row [H]."""
    leaning: Field
    """Column of the axis in each row [H], if the axis may lean."""
    symmetric: bool

    @classmethod
    def of(cls, solid: Mask) -> Profile:
        """Return the profile of a mask [H,W]."""
        rows = np.flatnonzero(solid.any(axis=1))
        solid = solid[rows[0] : rows[-1] + 1]
        low = solid.argmax(axis=1)
        high = solid.shape[1] - solid[:, ::-1].argmax(axis=1)
        half, middle = (high - low) / 2, (high + low) / 2
        axis = np.average(middle, weights=half)
        down = np.arange(len(half)) - np.average(np.arange(len(half)), weights=half)
        lean = (half * down * (middle - axis)).sum() / max((half * down**2).sum(), 1e-9)
        leaning = axis + np.clip(lean, -LEAN, LEAN) * down
        # The arcs at both ends do not lean.
        away = np.minimum(np.abs(middle - leaning), np.abs(middle - axis))
        centred = away < CENTRED * half.max()
        good = centred & (np.count_nonzero(solid, axis=1) == high - low)
        symmetric = len(half) >= FEWEST and bool(good.mean() >= EVERY)
        every = np.arange(rows[0], rows[-1] + 1.0)
        return cls(half, every, float(axis) - 0.5, middle - 0.5, leaning - 0.5, symmetric)

    @cached_property
    def top(self) -> int:
        """Number of rows of the upper arc, or 0."""
        return _arc(self.half)

    @property
    def rim(self) -> int:
        """The first row that is almost as wide as the widest row."""
        return int((self.half >= FULL * self.half.max()).argmax())

    @property
    def tapers(self) -> bool:
        """Whether the outline becomes narrower towards a tip, as of a shield."""
        height, widest = len(self.half), self.half.max()
        near_tip = self.half[-max(1, round(TIP_HEIGHT * height))]
        return bool(
            self.rim <= UPPER * height
            and near_tip <= TAPERED * widest
            and self._widening(self.rim) <= WIDENING * widest
            and height >= HIGHER * 2 * widest
        )

    def is_drum(self) -> bool:
        """Whether the sides are vertical and the lower edge is half of an ellipse."""
        bottom, top = _arc(self.half[::-1]), max(self.top, self.rim)
        core = self.half[top : len(self.half) - bottom]
        widest = self.half.max()
        if not bottom or len(core) < WALL * widest or core.min() < NARROWER * widest:
            return False
        return (
            LOWEST_VIEW * widest <= bottom <= HIGHEST_VIEW * widest
            and top <= bottom + MORE * widest
        )

    def is_vessel(self) -> bool:
        """Whether the object is widest at the rim and becomes narrower towards the foot."""
        height, widest = len(self.half), self.half.max()
        top = max(self.top, self.rim)
        if self.tapers or top > (LOW_RIM if self.top else FLAT_RIM) * height:
            return False
        if self.top + _arc(self.half[::-1]) > EGG * height:
            return False
        foot, span = max(1, round(FOOT * height)), max(1, round(SPAN * height))
        above = self.half[: height - foot]
        return bool(
            self._widening(top) <= WIDENING * widest
            and (above[:-span] - above[span:]).max() <= STEP * widest
            and self.half[-foot] <= NARROWER * widest
        )

    def _widening(self, row: int) -> float:
        below = self.half[row:]
        return float((np.maximum.accumulate(below[::-1])[::-1] - below).max())


def _arc(half: Field) -> int:
    """Return how many of the first rows form half of an ellipse; 0 if none."""
    best, least = 0, ELLIPTIC
    for rows in range(3, len(half) // 2 + 1):
        if rows > HIGHEST_VIEW * half[rows]:
            continue
        up = 1 - (np.arange(rows) + 0.5) / (rows + 0.5)
        ellipse = half[rows] * np.sqrt(1 - up**2)
        misfit = float(np.sqrt(np.mean((half[:rows] - ellipse) ** 2)) / half[rows])
        if misfit < least:
            best, least = rows, misfit
    return best


def _without_handles(solid: Mask) -> Mask | None:
    """Return a mask [H,W] without thin parts at the sides; None if there are no such parts."""
    depth = _inner_distance(np.pad(solid, 1))[1:-1, 1:-1]
    radius = THIN * float(depth.max())
    body = _inner_distance(depth < radius) <= radius
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(body.any(axis=0))
    reach = REACH * max(np.ptp(rows), np.ptp(columns))
    parts, number = scipy.ndimage.label(solid & ~body)  # pyright: ignore
    handles = np.zeros_like(solid)
    for index in range(1, number + 1):
        part = parts == index
        across = np.flatnonzero(part.any(axis=0))
        left, right = columns[0] - across[0], across[-1] - columns[-1]
        heights = np.count_nonzero(part, axis=0)[across][:: 1 if left > right else -1]
        if max(left, right) < reach or _is_pointed(heights, max(left, right)):
            continue
        if rows[-1] - np.flatnonzero(part.any(axis=1))[-1] < BELOW * len(rows):
            return None
        handles |= part
    return _complete(solid & ~handles, solid) if handles.any() else None


def _complete(body: Mask, solid: Mask) -> Mask:
    """Add the mirror image of a symmetric body [H,W] to the body, but only inside `solid`.

    Where a handle joins the body close to the rim, a corner of the rim looks like the handle.
    """
    profile = Profile.of(body)
    return body | (_mirror(body, profile.rows, profile.leaning) & solid)


def _without_bulge(solid: Mask) -> Mask | None:
    """Return a mask [H,W] without a bulge at one side, such as a handle in front of the body; None
    if most rows are not symmetric about one line, or if the bulge is large.
    """
    profile = Profile.of(solid)
    rows, middle = profile.rows, profile.middle
    tried = range(0, len(rows), max(1, len(rows) // TRIED))
    best, most = None, BULGE * len(rows)
    for first, last in combinations(tried, 2):
        lean = (middle[last] - middle[first]) / (last - first)
        line = middle[first] + lean * (rows - rows[first])
        near = np.abs(middle - line) <= 1
        if abs(lean) <= LEAN and np.count_nonzero(near) > most:
            best, most = near, np.count_nonzero(near)
    if best is None:
        return None
    lean, start = np.polyfit(rows[best], middle[best], 1)
    body = solid & _mirror(solid, rows, lean * rows + start)
    return body if body.sum() >= (1 - LARGEST) * solid.sum() else None


def _mirror(solid: Mask, rows: Field, axes: Field) -> Mask:
    """Mirror each of the rows [N] of a mask [H,W] about a column [N]."""
    mirrored, columns = np.zeros_like(solid), np.arange(solid.shape[1])
    for row, axis in zip(rows.astype(int), axes, strict=True):
        other = np.rint(2 * axis - columns).astype(int)
        inside = (other >= 0) & (other < len(other))
        mirrored[row] = inside & solid[row, other.clip(0, len(other) - 1)]
    return mirrored


def _inner_distance(solid: Mask) -> Field:
    precise = cv2.DIST_MASK_PRECISE
    distance = cv2.distanceTransform(solid.astype(np.uint8), cv2.DIST_L2, precise)
    return np.asarray(distance, np.float64)


def _is_pointed(heights: NDArray[np.int_], length: float) -> bool:
    """Whether a protruding part ends in a sharp edge, like the rim of a bowl; `heights` start at
    the tip.
    """
    tip = heights[: max(1, round(TIP * length))]
    return bool(tip.mean() < POINTED * heights.max())
