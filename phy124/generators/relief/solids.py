"""Which solid a silhouette is taken for, and how thick that is behind each pixel.

Round parts are as deep as they are wide: the union of all balls that fit inside, so a disc gives a
ball and a limb a cylinder. What looks turned on a lathe (every row one run about one axis, with a
waist) is as deep in each row as it is wide there. A figure of straight edges without shading is a
slab.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.ends import Continued
from phy124.generators.relief.height import Silhouette, nearest_of
from phy124.generators.relief.surface import Surface
from phy124.generators.relief.view import View

Field = NDArray[np.float64]
SMOOTHING = 0.02
"""Width over which thicknesses are smoothed, in picture sizes."""
CENTRED = 0.06
"""How far rows may be off the axis of what is turned on a lathe, in half widths."""
EVERY = 0.97
"""Fraction of the rows that must be so."""
WAISTED = 0.97
"""Area to that of the convex hull below which there is a waist."""
OVERHANG = 3.0
"""Largest depth to height of a brim of what is turned; a wing is thinner."""
STRAIGHT = 0.98
"""Overlap with a polygon of few corners from which the outline counts as straight."""
CORNERS = 12
ROUNDED = 0.1
"""Radius of a block's edges, in half widths."""
RIM = 3.0
"""Width over which the outline of a foot is rounded off, pixels."""
SHADED = 0.1
"""Change of brightness over a round side, relative to the mean, that shows that it is round."""


def inflated(
    silhouette: Silhouette, picture: Continued, view: View, size: int, thickness: float = 1.0
) -> Surface:
    """The surface of the solid that a silhouette is taken for.

    Args:
        silhouette: With its continuation beyond flat ends.
        picture: Colours, and where the object itself is.
        view: The front camera.
        size: Of the object, pixels.
        thickness: Depth relative to what the silhouette suggests.
    """
    half = half_thickness(silhouette, picture, size)
    if half is None:
        return _slab(picture, view, thickness)
    surface = Surface.seen(silhouette.extended(thickness**2 * half), view.middle, view.distance)
    if any(end.divided for end in picture.ends):
        return Surface.of(_with_feet(surface.w, picture), surface.m)
    return surface


def _with_feet(w: Field, picture: Continued) -> Field:
    """Squared half thicknesses where round feet are as deep as what stands on them.

    Beyond the corners there is their outline instead of the mirror image's; its rim is round.
    """
    distance = np.where(
        picture.own, nearest_of(~picture.own)[0] - 0.5, 0.5 - nearest_of(picture.own)[0]
    )
    feet = np.maximum(w, 1.0) * np.clip(distance / RIM, -4, 1)
    rows = np.arange(len(w))[:, None]
    for end in picture.ends:
        if end.divided:
            w = np.where((rows - end.corner) * end.sign > 0, np.minimum(w, feet), w)
    return w


def half_thickness(silhouette: Silhouette, picture: Continued, size: int) -> Field | None:
    """Squared half thicknesses [H,W] of what is round; None of what is taken for a slab.

    Args:
        silhouette: With its continuation beyond flat ends.
        picture: Colours, and where the object itself is.
        size: Of the object, pixels.
    """
    round_ = _within(silhouette, _balls(silhouette.inside), 0.3, 1.2, size)
    if _polygonal(picture.own) and not _shaded(picture, round_):
        return None
    if (lathe := _lathe(picture)) is not None:
        lathe = np.maximum(lathe, round_)
        limit = _smooth(lathe, silhouette.inside, 2.0)
        round_ = np.minimum(_within(silhouette, lathe, 0.3, 30, size), limit)
    return round_


def flat_topped(inside: NDArray[np.bool_]) -> Field:
    """Squared half thickness [H,W] of a block as wide as the silhouette, negative outside."""
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    widest = float(distance.max())
    return widest**2 * np.clip(distance / max(2.0, ROUNDED * widest), -4, 1)


def _within(silhouette: Silhouette, wanted: Field, low: float, high: float, size: int) -> Field:
    """Squared half thicknesses, smooth and zero exactly on the rim.

    The solution u of -Laplace(u) = 4 is so (on a disc it is the ball); it is scaled by the smoothed
    ratio to what is wanted.
    """
    u = silhouette.poisson(4.0)
    ratio = np.clip(wanted / np.maximum(u, 1e-9), low, high)
    return u * _smooth(ratio, silhouette.inside, max(1.0, SMOOTHING * size))


def _balls(inside: NDArray[np.bool_]) -> Field:
    """Squared half thickness of the union of all balls that fit behind the silhouette.

    It is the maximum over centres m of D(m)^2 - |x - m|^2, with D the distance to the rim: a
    separable upper envelope of parabolas.
    """
    # From the pixel's centre to the rim between it and the next pixel outside.
    squares = np.where(inside, (nearest_of(~inside)[0] - 0.5) ** 2, 0.0)
    for _ in range(2):
        offsets = np.arange(squares.shape[1])
        parabolas = (offsets[:, None] - offsets).astype(np.float64) ** 2
        squares = np.stack([(row - parabolas).max(axis=1) for row in squares]).T
    return np.where(inside, squares, 0.0)


def _lathe(picture: Continued) -> Field | None:
    """Squared half thicknesses if the object looks turned about a vertical axis."""
    own = picture.own
    rows = np.flatnonzero(own.any(axis=1))
    low, high = own[rows].argmax(axis=1), own.shape[1] - own[rows, ::-1].argmax(axis=1)
    middle, half = (low + high) / 2, (high - low) / 2
    axis = np.average(middle, weights=half)
    single = np.count_nonzero(own[rows], axis=1) == high - low
    good = single & (np.abs(middle - axis) < CENTRED * half.max())
    if good.mean() < EVERY or _solidity(own) > WAISTED:
        return None
    inside = picture.alpha > 0.5
    x = np.arange(inside.shape[1])
    low, high = inside.argmax(axis=1), inside.shape[1] - inside[:, ::-1].argmax(axis=1)
    round_ = (x + 0.5 - low[:, None]) * (high[:, None] - x - 0.5)
    tall = OVERHANG / 2 * _runs(inside)
    return np.where(inside, np.clip(round_, 0, tall**2), 0.0)


def _runs(inside: NDArray[np.bool_]) -> Field:
    """Length of the vertical run of pixels that each pixel inside belongs to."""
    rows = np.arange(len(inside))[:, None]
    above = np.maximum.accumulate(np.where(inside, -1, rows), axis=0)
    below = np.minimum.accumulate(np.where(inside, len(rows), rows)[::-1], axis=0)[::-1]
    return (below - above - 1).astype(np.float64)


def _outline(own: NDArray[np.bool_]) -> NDArray:
    outlines, _ = cv2.findContours(own.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return max(outlines, key=len)


def _solidity(own: NDArray[np.bool_]) -> float:
    """Area to that of the convex hull."""
    hull = cv2.convexHull(_outline(own))
    return float(np.count_nonzero(own) / max(cv2.contourArea(hull), 1.0))


def _polygonal(own: NDArray[np.bool_]) -> bool:
    """Whether the outline consists of few straight lines."""
    outline = _outline(own)
    corners = cv2.approxPolyDP(outline, 0.01 * cv2.arcLength(outline, closed=True), closed=True)
    drawn = cv2.fillPoly(np.zeros(own.shape, np.uint8), [corners], 1) > 0
    overlap = np.count_nonzero(drawn & own) / np.count_nonzero(drawn | own)
    return 3 <= len(corners) <= CORNERS and bool(overlap > STRAIGHT)


def _shaded(picture: Continued, round_: Field) -> bool:
    """Whether brightness changes across the object as it would on a round one.

    Brightness is fitted as a linear function of the round solid's normals. Only the part across and
    towards the viewer counts: colours often differ from bottom to top.
    """
    seen = np.asarray(scipy.ndimage.binary_erosion(picture.own, iterations=4), bool)
    if not seen.any():
        return True
    slopes = np.asarray(np.gradient(scipy.ndimage.gaussian_filter(round_, 1.0)))
    half = np.sqrt(np.maximum(round_, 1.0))
    normals = np.stack([-slopes[1] / 2, -slopes[0] / 2, half], axis=2)[seen]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bright = picture.rgba[..., :3].mean(axis=2)[seen]
    known = np.column_stack([normals, np.ones(len(normals))])
    fitted = np.linalg.lstsq(known, bright, rcond=None)[0]
    across, towards = float(fitted[0]), float(fitted[2])
    return bool(abs(across) + abs(towards) > SHADED * bright.mean())


def _slab(picture: Continued, view: View, thickness: float) -> Surface:
    """A flat front and back with walls between: a square gives a cube, others are thinner."""
    own = picture.own
    rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
    sides = np.ptp(rows) + 1, np.ptp(columns) + 1
    aspect, full = min(sides) / max(sides), np.count_nonzero(own) / (sides[0] * sides[1])
    inside = picture.alpha > 0.5
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    h = float(distance.max() * aspect**3 * full) * thickness
    h /= 1 + h / view.distance  # The front is nearer than the middle, and so seen larger.
    # The camera sees the walls' front edges on the rim; farther back they lie behind the front.
    dy, dx = np.gradient(scipy.ndimage.gaussian_filter(distance, 1.0))
    y, x = np.mgrid[: own.shape[0], : own.shape[1]]
    out = -(dx * (x - view.middle[0]) + dy * (y - view.middle[1]))
    wall = (out + distance) * (1 - h / view.distance) / np.maximum(out, 1e-9)
    far = np.clip(np.where(out > 1, view.distance * (1 - wall), -h), -h, h)
    edge = np.clip(distance / max(2.0, 0.1 * h), -1, 1)
    rounded = h * np.sign(edge) * (1 - (1 - np.abs(edge)) ** 2)
    half = np.maximum((h - far) / 2, 1.0)
    w = np.minimum(half, np.maximum(rounded, 0)) ** 2 + np.minimum(distance, 0) * h
    return Surface.of(
        scipy.ndimage.gaussian_filter(w, 1.0), scipy.ndimage.gaussian_filter((h + far) / 2, 1.0)
    )


def _smooth(values: Field, inside: NDArray[np.bool_], width: float) -> Field:
    """Gaussian smoothing restricted to the pixels inside."""
    fraction = scipy.ndimage.gaussian_filter(inside.astype(np.float64), width)
    smooth = scipy.ndimage.gaussian_filter(np.where(inside, values, 0.0), width)
    return np.where(inside, smooth / np.maximum(fraction, 1e-9), 0.0)
