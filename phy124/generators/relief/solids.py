"""Guesses the solid for a silhouette: a round shape, a solid of revolution, or a slab.

Round parts are as deep as they are wide: the solid is the union of all balls that fit inside, which
turns a disc into a ball and a limb into a cylinder. An object looks like a solid of revolution if
each row is a single run about a common axis and the outline has a waist; each row is then as deep
as it is wide. A shape with straight edges and without shading becomes a flat slab. A depth map
replaces the guessed shape of the front.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.generators.relief.ends import Continued, End, stands
from phy124.generators.relief.height import Silhouette, nearest_of
from phy124.generators.relief.surface import Surface, View, smooth

Field = NDArray[np.float64]
SMOOTHING = 0.02
"""Standard deviation of the filter that smooths thicknesses, in image sizes."""
CENTRED = 0.06
"""Largest distance of a row's centre from the axis of revolution, relative to half the object's
largest width."""
EVERY = 0.97
"""Smallest fraction of the rows that must fit a solid of revolution."""
WAISTED = 0.97
"""A silhouette has a waist if its area, divided by that of its convex hull, is at most this."""
COMPACT = 1.25
"""Largest ratio of the longer to the shorter side of a convex shape that looks like a solid of
revolution; longer shapes may lie on their side, unless `stands`."""
OVERHANG = 3.0
"""Largest ratio of depth to height of a brim; limits the depth of thin features such as wings."""
STRAIGHT = 0.98
"""An outline has straight edges if it overlaps with a polygon of few corners by at least this
(IoU)."""
CORNERS = 12
BOXED = 0.95
"""Smallest part of its bounding rectangle that a rectangle with rounded corners fills."""
ROUNDED = 0.1
"""Radius of a block's edges, relative to half the block's width."""
RIM = 3.0
"""Width over which the outline of a foot is rounded [pixels]."""
SHADED = 0.1
"""Smallest change of brightness across a shaded round object, relative to its mean."""
FRAME, LEAST_FRAME = 0.2, 4.0
"""Largest width of a frame, relative to half the object's width, and its smallest value
[pixels]."""
NOISE, ROUNDS = 0.01, 10
"""Noise of the brightness relative to its mean, and rounds of the fit to most pixels."""


def inflate(
    half: Field, silhouette: Silhouette, picture: Continued, view: View, thickness: float = 1.0
) -> Surface:
    """Return the surface of a round object.

    Args:
        half: Squared half thicknesses from `half_thickness` [H,W].
        silhouette: The silhouette, extended beyond flat ends.
        picture: Colours, and mask of the object.
        view: The front camera.
        thickness: Factor on the guessed depth.
    """
    surface = Surface.seen(silhouette.extend(thickness**2 * half), view.middle, view.distance)
    if not picture.ends:
        return surface
    divided = any(end.divided for end in picture.ends)
    w = _with_feet(surface.w, picture) if divided else surface.w
    return Surface.of(w, _straighten(surface, picture.ends))


def _straighten(surface: Surface, ends: tuple[End, ...]) -> Field:
    """Return the midsurface [H,W] without a ridge at flat ends.

    The silhouette is narrower in an end's arc, but the object is not; a ball that becomes narrower
    has its midsurface nearer to the camera.
    """
    rows, widths = np.arange(len(surface.m)), np.count_nonzero(surface.w > 0, axis=1)
    m = surface.m
    for end in ends:
        shoulder = round(2 * end.corner - end.outermost)
        above = round(shoulder + end.corner - end.outermost)
        if widths[shoulder] <= widths[above]:
            near = (rows - shoulder) * end.sign > 0
            m = np.where(near[:, None], np.minimum(m, np.maximum(m[shoulder], 0)), m)
    return m


def _with_feet(w: Field, picture: Continued) -> Field:
    """Return squared half thicknesses with round feet as deep as the object above them.

    Beyond the corners, the silhouette of the feet, with a rounded rim, replaces the mirror image.
    """
    distance = np.where(
        picture.object_mask,
        nearest_of(~picture.object_mask)[0] - 0.5,
        0.5 - nearest_of(picture.object_mask)[0],
    )
    feet = np.maximum(w, 1.0) * np.clip(distance / RIM, -4, 1)
    rows = np.arange(len(w))[:, None]
    for end in picture.ends:
        if end.divided:
            w = np.where((rows - end.corner) * end.sign > 0, np.minimum(w, feet), w)
    return w


def half_thickness(silhouette: Silhouette, picture: Continued, size: int) -> Field | None:
    """Return the squared half thicknesses [H,W] of a round object; None for a slab.

    Args:
        silhouette: The silhouette, extended beyond flat ends.
        picture: Colours, and mask of the object.
        size: Size of the object, pixels.
    """
    round_ = _within(silhouette, _balls(silhouette), 0.3, 1.2, size)
    if _polygonal(picture.object_mask) and not _is_shaded(picture, round_):
        return None
    if is_turned(picture.object_mask):
        lathe = np.maximum(_lathe(silhouette), round_)
        limit = smooth(lathe, silhouette.inside, 2.0)
        round_ = np.minimum(_within(silhouette, lathe, 0.3, 30, size), limit)
    return round_


def flat_topped(inside: NDArray[np.bool_]) -> Field:
    """Return the squared half thicknesses [H,W] of a block as deep as the silhouette is wide."""
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    widest = float(distance.max())
    return widest**2 * np.clip(distance / max(2.0, ROUNDED * widest), -4, 1)


def _within(silhouette: Silhouette, wanted: Field, low: float, high: float, size: int) -> Field:
    """Return squared half thicknesses near `wanted` that are smooth and exactly 0 on the rim.

    The solution u of -Laplace(u) = 4 is smooth and 0 on the rim (for a disc it gives the ball). The
    result is u times the smoothed ratio of the wanted thickness to u.
    """
    u = silhouette.poisson(4.0)
    ratio = np.clip(wanted / np.maximum(u, 1e-9), low, high)
    width = max(1.0, SMOOTHING * size)
    # At the rim, both are almost 0 and their ratio is inexact.
    weight = np.minimum(silhouette.distance, width)
    return u * smooth(ratio, weight, width)


def _balls(silhouette: Silhouette) -> Field:
    """Return the squared half thicknesses of the union of all balls in the silhouette.

    The result is the maximum over centres m of D(m)^2 - |x - m|^2, with D the distance to the rim.
    The result is an upper envelope of parabolas, which is computed along one axis after the other.
    """
    squares = silhouette.distance**2
    for _ in range(2):
        offsets = np.arange(squares.shape[1])
        parabolas = (offsets[:, None] - offsets).astype(np.float64) ** 2
        squares = np.stack([(row - parabolas).max(axis=1) for row in squares]).T
    return np.where(silhouette.inside, squares, 0.0)


def is_turned(object_mask: NDArray[np.bool_]) -> bool:
    """Whether a silhouette [H,W] looks like a solid of revolution with a vertical axis."""
    rows = np.flatnonzero(object_mask.any(axis=1))
    low, high = (
        object_mask[rows].argmax(axis=1),
        object_mask.shape[1] - object_mask[rows, ::-1].argmax(axis=1),
    )
    middle, half = (low + high) / 2, (high - low) / 2
    axis = np.average(middle, weights=half)
    single = np.count_nonzero(object_mask[rows], axis=1) == high - low
    good = single & (np.abs(middle - axis) < CENTRED * half.max())
    if good.mean() < EVERY:
        return False
    tall = len(rows) / (2 * half.max())
    compact = 1 / COMPACT < tall < COMPACT
    return compact or _solidity(object_mask) <= WAISTED or (tall < 1 and stands(object_mask))


def _lathe(silhouette: Silhouette) -> Field:
    """Return squared half thicknesses of a vertical solid of revolution."""
    inside = silhouette.inside
    left, right = silhouette.sides()
    x = np.arange(inside.shape[1])
    round_ = (x - left[:, None]) * (right[:, None] - x)
    deepest = OVERHANG / 2 * _runs(inside)
    return np.where(inside, np.clip(round_, 0, deepest**2), 0.0)


def _runs(inside: NDArray[np.bool_]) -> Field:
    """Return for each inside pixel the length of the vertical run of pixels around it [H,W]."""
    rows = np.arange(len(inside))[:, None]
    above = np.maximum.accumulate(np.where(inside, -1, rows), axis=0)
    below = np.minimum.accumulate(np.where(inside, len(rows), rows)[::-1], axis=0)[::-1]
    return (below - above - 1).astype(np.float64)


def _outline(object_mask: NDArray[np.bool_]) -> NDArray:
    outlines, _ = cv2.findContours(
        object_mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    return max(outlines, key=len)


def _solidity(object_mask: NDArray[np.bool_]) -> float:
    """Return the ratio of the silhouette's area to that of its convex hull."""
    hull = cv2.convexHull(_outline(object_mask))
    return float(np.count_nonzero(object_mask) / max(cv2.contourArea(hull), 1.0))


def _polygonal(object_mask: NDArray[np.bool_]) -> bool:
    """Whether the outline consists of at most `CORNERS` straight lines, or is a rectangle with
    rounded corners.
    """
    outline = _outline(object_mask)
    width, height = cv2.minAreaRect(outline)[1]
    if np.count_nonzero(object_mask) > BOXED * (width + 1) * (height + 1):
        return True
    corners = cv2.approxPolyDP(outline, 0.01 * cv2.arcLength(outline, closed=True), closed=True)
    drawn = cv2.fillPoly(np.zeros(object_mask.shape, np.uint8), [corners], 1) > 0
    overlap = np.count_nonzero(drawn & object_mask) / np.count_nonzero(drawn | object_mask)
    return 3 <= len(corners) <= CORNERS and bool(overlap > STRAIGHT)


def _is_shaded(picture: Continued, round_: Field) -> bool:
    """Whether the brightness changes across the object as on a shaded round object.

    The brightness is fitted by a linear function of the round solid's normals. Only the component
    towards the camera is used, which is largest in the middle of a round object. Gradients on a
    flat object, printed or caused by light, run from one side to the other instead. The median of
    each row is subtracted, because labels, or the roof of a house, are horizontal bands. Frames are
    excluded. A wide object may be lying on its side, so columns are tried in place of rows, too.
    """
    depth, _ = nearest_of(~picture.object_mask)
    seen = depth > max(LEAST_FRAME, FRAME * float(depth.max()))
    if not seen.any():
        return True
    slopes = np.asarray(np.gradient(scipy.ndimage.gaussian_filter(round_, 1.0)))
    half = np.sqrt(np.maximum(round_, 1.0))
    normals = np.stack([-slopes[1] / 2, -slopes[0] / 2, half], axis=2)[seen]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bright = picture.rgba[..., :3].mean(axis=2)[seen]
    known = np.column_stack([normals, np.ones(len(normals))])
    rows, columns = np.nonzero(seen)
    wide = np.ptp(columns) > COMPACT * np.ptp(rows)
    changes = []
    for band in (rows, columns) if wide else (rows,):
        medians = np.asarray(scipy.ndimage.median(bright, band, np.arange(max(seen.shape))))
        _, _, towards, _ = _fit_most(known, bright - medians[band], NOISE * float(bright.mean()))
        changes.append(abs(towards))
    return bool(max(changes) > SHADED * bright.mean())


def _fit_most(known: Field, values: Field, noise: float) -> list[float]:
    """Fit values [N] linearly by the columns of `known` [N,C], with the smallest absolute errors.

    Unlike least squares, this fit ignores the minority of pixels on letters and frames.
    """
    weights = np.ones(len(values))
    fitted = np.zeros(known.shape[1])
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        fitted = np.linalg.lstsq(root[:, None] * known, root * values, rcond=None)[0]
        weights = 1 / np.maximum(np.abs(values - known @ fitted), noise)
    return fitted.tolist()


def make_slab(picture: Continued, view: View, thickness: float = 1.0) -> Surface:
    """Return a slab with flat front and back: a square becomes a cube, other shapes are thinner.

    Args:
        picture: Mask of the object.
        view: The front camera.
        thickness: Factor on the guessed depth.
    """
    object_mask = picture.object_mask
    rows, columns = np.flatnonzero(object_mask.any(axis=1)), np.flatnonzero(object_mask.any(axis=0))
    sides = np.ptp(rows) + 1, np.ptp(columns) + 1
    aspect, full = min(sides) / max(sides), np.count_nonzero(object_mask) / (sides[0] * sides[1])
    inside = picture.alpha > 0.5
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    h = float(distance.max() * aspect**3 * full) * thickness
    h /= 1 + h / view.distance  # the front is nearer than the centre and therefore appears larger
    # The camera sees the walls' front edges at the rim; the front hides the walls behind them.
    dy, dx = np.gradient(scipy.ndimage.gaussian_filter(distance, 1.0))
    y, x = np.mgrid[: object_mask.shape[0], : object_mask.shape[1]]
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


MIXED_RIM = 8.0
"""Width of the zone along the rim in which depth maps mix object and background [pixels]."""
PLANE = 0.01
"""Smallest standard deviation of the depth, as a fraction of the map's range; below it, the front
is flat."""
THINNEST = 2.0
"""Smallest half thickness away from the rim [pixels]."""


def normalise_depth(depth: NDArray, alpha: NDArray) -> NDArray[np.float32]:
    """Normalise a depth map to 0..1, and check it against the object's alpha [H,W].

    Raises:
        InputError: If the map is constant, or the object is farther away than its surroundings.
    """
    low, high = float(depth.min()), float(depth.max())
    if high - low <= 1e-6 * max(abs(low), abs(high), 1e-30):
        limit = "The depth map is constant."
        raise InputError("depth", "map", limit, "Give the network's output before any rounding.")
    inside, outside = alpha > 127, alpha == 0
    if outside.any() and float(depth[inside].mean()) < float(depth[outside].mean()):
        limit = "The object is farther away than its surroundings."
        remedy = "If black is near, add --near black; if white is near, leave --near out."
        raise InputError("depth", "map", limit, remedy)
    return ((depth - low) / (high - low)).astype(np.float32)


def apply_depth(surface: Surface, depth: Field, object_mask: NDArray[np.bool_]) -> Surface:
    """Replace the front of a surface by a depth map [H,W] in 0..1, in which near is 1.

    The scale and offset of the map are unknown. The mean and standard deviation of the map are
    therefore set to those of the inflated front, unless the map is flat. The back is unchanged.
    """
    far, _ = nearest_of(~object_mask)
    known = far > min(MIXED_RIM / 2, 0.5 * float(far.max()))
    half = np.sqrt(np.maximum(surface.w, 0.0))
    front, back = surface.m + half, surface.m - half
    spread = float(depth[known].std())
    scale = float(front[known].std()) / spread if spread > PLANE else 0.0
    shaped = (depth - depth[known].mean()) * scale + front[known].mean()
    part = np.clip((far - 1) / MIXED_RIM, 0, 1)
    part = part * part * (3 - 2 * part)
    shaped = scipy.ndimage.gaussian_filter((1 - part) * front + part * shaped, 1.0)
    thickness = np.maximum((shaped - back) / 2, np.minimum(half, THINNEST))
    inside = surface.w > 0
    w = np.where(inside & object_mask, thickness**2, surface.w)
    return Surface.of(
        w, np.where(inside & object_mask, back + np.sqrt(np.maximum(w, 0)), surface.m)
    )
