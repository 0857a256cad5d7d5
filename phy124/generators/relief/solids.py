"""Guesses which solid a silhouette shows: a round shape, a solid of revolution, or a slab.

A round solid is the union of all balls that fit inside, so a disc becomes a ball and a limb becomes
a cylinder. A solid of revolution is as deep as it is wide in each row. A shape with straight edges
and without shading is a flat slab. A depth map replaces the guessed front.
"""

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.generators.relief.angular import is_angular
from phy124.generators.relief.ends import Continued, End, stands
from phy124.generators.relief.height import Silhouette, nearest_of
from phy124.generators.relief.outlines import outline_of, solidity
from phy124.generators.relief.robust import fit_most
from phy124.generators.relief.surface import Surface, View, smooth
from phy124.generators.relief.upright import Profile

Field = NDArray[np.float64]
SMOOTHING = 0.02
"""Standard deviation of the filter that smooths the thickness, relative to the image's size."""
CENTRED = 0.06
"""Largest distance of a row's centre from the axis, relative to half the object's largest width."""
EVERY = 0.97
"""Smallest fraction of the rows that match a solid of revolution."""
WAISTED = 0.97
"""Largest area of a silhouette with a waist, relative to the convex hull."""
COMPACT = 1.25
"""A convex shape is a solid of revolution only up to this ratio of its sides. Longer shapes may lie
on their side.
"""
CONVEX = 0.93
"""Smallest area of a convex silhouette, relative to the convex hull."""
OVERHANG = 3.0
"""Largest ratio of depth to height of a part of the silhouette. It limits parts such as wings."""
STRAIGHT = 0.98
"""Smallest overlap (IoU) of a straight-edged outline with a polygon."""
CORNERS = 12
BOXED = 0.95
"""Smallest area of a rectangle with rounded corners, relative to the bounding rectangle."""
ROUNDED = 0.1
"""Radius of a block's edges, relative to half the block's width."""
RIM = 3.0
"""Width of a foot's rounded rim [pixels]."""
SHADED = 0.1
"""Smallest change of brightness across a shaded object, relative to the mean."""
FRAME, LEAST_FRAME = 0.2, 4.0
"""Limits of the width of a frame: relative to half the object's width, and in pixels. The larger
limit applies.
"""
NOISE = 0.01
"""Noise of the brightness, relative to the mean."""
NARROW = (0.4, 0.5)
"""Ratios of a slab's width to its length. Below the first ratio, the slab has a minimum thickness.
Above the second ratio, a rectangle may be a sheet of any thickness.
"""
LEAST = 0.25
"""Smallest thickness of a slab that is neither an upright bar nor a page, relative to its width."""
STEPS = 32
"""Number of steps along a view ray through a slab."""


def inflate(
    half: Field, silhouette: Silhouette, picture: Continued, view: View, thickness: float = 1.0
) -> Surface:
    """Return the surface of a round object.

    Args:
        half: Squared half thicknesses [H,W] from `half_thickness`.
        silhouette: The silhouette, extended beyond flat ends.
        picture: Colours of the image, and mask of the object.
        view: The front camera.
        thickness: Factor of the guessed depth.
    """
    surface = Surface.seen(silhouette.extend(thickness**2 * half), view.middle, view.distance)
    if not picture.ends:
        return surface
    divided = any(end.divided for end in picture.ends)
    w = _with_feet(surface.w, picture) if divided else surface.w
    return Surface.of(w, _straighten(surface, picture.ends))


def _straighten(surface: Surface, ends: tuple[End, ...]) -> Field:
    """Return the midsurface [H,W] without a ridge at flat ends.

    A ball's midsurface is nearer to the camera where the ball is narrower. At a flat end, only the
    silhouette becomes narrower, so the midsurface must not follow it there.
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


def round_thickness(silhouette: Silhouette, size: int) -> Field:
    """Return squared half thicknesses [H,W] of parts as deep as they are wide [pixels^2]."""
    _ = silhouette.factors  # a thread computes them meanwhile
    return _within(silhouette, _balls(silhouette), 0.3, 1.2, size)


def half_thickness(
    silhouette: Silhouette,
    picture: Continued,
    size: int,
    shape: str = "auto",
    joined: Field | None = None,
) -> Field | None:
    """Return the squared half thicknesses [H,W] of a round object; None if the object is a slab.

    Args:
        silhouette: The silhouette, extended beyond flat ends.
        picture: Colours of the image, and mask of the object.
        size: Size of the object [pixels].
        shape: "upright" for a solid of revolution, "round" or "flat" for an object that is neither
            a solid of revolution nor a slab; "auto": the most plausible one.
        joined: Squared half thicknesses [H,W] of parts that were inflated separately, or None.
    """
    round_ = round_thickness(silhouette, size) if joined is None else joined
    if shape in ("round", "flat"):
        return round_
    if shape == "auto" and is_polygonal(picture.object_mask) and not _is_shaded(picture, round_):
        return None
    turned = shape == "upright" or picture.body is not None
    turned = turned or (is_turned(picture.object_mask) and not is_block(picture))
    if turned:
        lathe = np.maximum(_lathe(silhouette, picture), round_)
        limit = smooth(lathe, silhouette.inside, 2.0)
        round_ = np.minimum(_within(silhouette, lathe, 0.3, 30, size), limit)
    return round_


def flat_topped(inside: NDArray[np.bool_]) -> Field:
    """Return squared half thicknesses [H,W] of a block as deep as it is wide."""
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    widest = float(distance.max())
    return widest**2 * np.clip(distance / max(2.0, ROUNDED * widest), -4, 1)


def _within(silhouette: Silhouette, wanted: Field, low: float, high: float, size: int) -> Field:
    """Return a smooth field that is close to `wanted`, and 0 on the rim.

    The solution u of -Laplace(u) = 4 describes a ball if the rim is a circle. The result is u times
    the smoothed ratio `wanted` / u.
    """
    u = silhouette.poisson(4.0)
    ratio = np.clip(wanted / np.maximum(u, 1e-9), low, high)
    width = max(1.0, SMOOTHING * size)
    # At the rim, numerator and denominator are almost 0, so their ratio is inaccurate.
    weight = np.minimum(silhouette.distance, width)
    return u * smooth(ratio, weight, width)


def _balls(silhouette: Silhouette) -> Field:
    """Return the squared half thicknesses of the union of all balls inside the silhouette.

    The result is the maximum over m of D(m)^2 - |x - m|^2, where D is the distance to the rim.
    """
    squares = silhouette.distance**2
    reach = int(silhouette.distance.max())
    for _ in range(2):
        squares = np.ascontiguousarray(squares)
        highest, lowered = squares.copy(), np.empty_like(squares)
        for step in range(1, min(reach + 1, len(squares))):
            np.subtract(squares, float(step**2), out=lowered)
            np.maximum(highest[step:], lowered[:-step], out=highest[step:])
            np.maximum(highest[:-step], lowered[step:], out=highest[:-step])
        squares = highest.T
    return np.where(silhouette.inside, squares, 0.0)


def is_turned(object_mask: NDArray[np.bool_]) -> bool:
    """Whether a silhouette [H,W] may be a solid of revolution with a vertical axis."""
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
    return compact or solidity(object_mask) <= WAISTED or (tall < 1 and stands(object_mask))


def is_block(picture: Continued) -> bool:
    """Whether a symmetric outline belongs to an angular object, such as a printer.

    Objects with arcs at both ends are cylinders, and therefore not angular. Convex objects that end
    in a tip, such as shields and clothes, count as angular.
    """
    solid = picture.object_mask
    if picture.body is not None:
        return False
    profile = Profile.of(solid)
    if profile.symmetric and profile.tapers and solidity(solid) > CONVEX:
        return True
    return is_turned(solid) and not stands(solid) and is_angular(picture.rgba)


def _lathe(silhouette: Silhouette, picture: Continued) -> Field:
    """Return squared half thicknesses [H,W] of a solid of revolution, with thin parts limited by
    `OVERHANG`. A vessel is not limited.
    """
    inside, body = silhouette.inside, picture.body
    left, right = silhouette.sides()
    deepest = OVERHANG / 2 * _runs(inside)
    if body is not None:
        deepest = np.full(inside.shape, np.inf)
        handles = (picture.object_mask & ~body).any(axis=1) & body.any(axis=1)
        left = np.where(handles, body.argmax(axis=1) - 0.5, left)
        right = np.where(handles, body.shape[1] - body[:, ::-1].argmax(axis=1) - 0.5, right)
    x = np.arange(inside.shape[1])
    round_ = (x - left[:, None]) * (right[:, None] - x)
    return np.where(inside, np.clip(round_, 0, deepest**2), 0.0)


def _runs(inside: NDArray[np.bool_]) -> Field:
    """Return the length of the vertical run that contains each pixel [H,W]."""
    rows = np.arange(len(inside))[:, None]
    above = np.maximum.accumulate(np.where(inside, -1, rows), axis=0)
    below = np.minimum.accumulate(np.where(inside, len(rows), rows)[::-1], axis=0)[::-1]
    return (below - above - 1).astype(np.float64)


def is_polygonal(object_mask: NDArray[np.bool_]) -> bool:
    """Whether the outline is a polygon of few corners or a rounded rectangle."""
    outline = outline_of(object_mask)
    width, height = cv2.minAreaRect(outline)[1]
    if np.count_nonzero(object_mask) > BOXED * (width + 1) * (height + 1):
        return True
    corners = cv2.approxPolyDP(outline, 0.01 * cv2.arcLength(outline, closed=True), closed=True)
    drawn = cv2.fillPoly(np.zeros(object_mask.shape, np.uint8), [corners], 1) > 0
    overlap = np.count_nonzero(drawn & object_mask) / np.count_nonzero(drawn | object_mask)
    return 3 <= len(corners) <= CORNERS and bool(overlap > STRAIGHT)


def _is_shaded(picture: Continued, round_: Field) -> bool:
    """Whether the brightness changes as on a shaded round object.

    The brightness is fitted by the normals of a round object. Only the coefficient of the component
    towards the camera counts, because flat objects may also be brighter at one side. To ignore
    painted bands, the median of each row is subtracted; a frame along the outline is excluded.
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
        _, _, towards, _ = fit_most(known, bright - medians[band], NOISE * float(bright.mean()))
        changes.append(abs(towards))
    return bool(max(changes) > SHADED * bright.mean())


def make_slab(
    picture: Continued, view: View, thickness: float = 1.0, most: float | None = None
) -> Surface:
    """Return a slab with a flat front and a flat back. A square becomes a cube, an upright bar is
    as deep as wide, and other shapes are thinner.

    Args:
        picture: Mask of the object.
        view: The front camera.
        thickness: Factor of the guessed depth.
        most: Largest half thickness before the multiplication by `thickness` [pixels]. The smallest
            half thickness is half of it. None: no limits.
    """
    object_mask = picture.object_mask
    rows, columns = np.flatnonzero(object_mask.any(axis=1)), np.flatnonzero(object_mask.any(axis=0))
    sides = np.ptp(rows) + 1, np.ptp(columns) + 1
    aspect, full = min(sides) / max(sides), np.count_nonzero(object_mask) / (sides[0] * sides[1])
    inside = picture.alpha > 0.5
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    widest = float(distance.max())
    h = widest * aspect**3 * full
    if most is None:
        rectangle = full > BOXED
        least = 1.0 if rectangle and sides[0] > sides[1] else LEAST
        page = 0.0 if rectangle else LEAST
        h = max(h, widest * float(np.interp(2 * widest / max(sides), NARROW, (least, page))))
    else:
        h = min(max(h, most / 2), most)
    h *= thickness
    # the front appears larger, because it is nearer to the camera than the centre
    h /= 1 + h / view.distance
    far = _hide(distance, view, h)
    edge = np.clip(distance / max(2.0, 0.1 * h), -1, 1)
    rounded = h * np.sign(edge) * (1 - (1 - np.abs(edge)) ** 2)
    half = np.maximum((h - far) / 2, 1.0)
    w = np.minimum(half, np.maximum(rounded, 0)) ** 2 + np.minimum(distance, 0) * h
    return Surface.of(
        scipy.ndimage.gaussian_filter(w, 1.0), scipy.ndimage.gaussian_filter((h + far) / 2, 1.0)
    )


def _hide(distance: Field, view: View, h: float) -> Field:
    """Return z [H,W] of the deepest points that a slab's front hides from the camera [pixels].

    The camera sees the front edges of the walls at the rim. A deeper point appears closer to the
    image's centre, so a view ray leaves the slab through a wall if it is close to the rim.

    Args:
        distance: Distance from the rim; negative outside [H,W].
        view: The front camera.
        h: Half thickness [pixels].
    """
    y, x = np.mgrid[: distance.shape[0], : distance.shape[1]]
    x, y = x - view.middle[0], y - view.middle[1]
    before, hidden = distance, np.zeros_like(distance)
    for scale in view.k(np.linspace(h, -h, STEPS + 1))[1:] / view.k(np.array(h)):
        places = view.middle[1] + scale * y, view.middle[0] + scale * x
        after = scipy.ndimage.map_coordinates(distance, places, order=1, mode="nearest")
        after = np.minimum(after, before)
        hidden += np.clip(before / np.maximum(before - after, 1e-9), 0, 1)
        before = after
    return h - 2 * h / STEPS * hidden


MIXED_RIM = 8.0
"""Width of the strip along the rim in which a depth map mixes the depths of object and background
[pixels].
"""
PLANE = 0.01
"""A front is flat if the standard deviation of its depth is at most this fraction of the depth's
range.
"""
THINNEST = 2.0
"""Smallest half thickness away from the rim [pixels]."""


def normalise_depth(depth: NDArray, alpha: NDArray) -> NDArray[np.float32]:
    """Normalise a depth map to 0..1, and compare the map with the object's alpha [H,W].

    Raises:
        InputError: If the map is constant, or the object is farther away than its surroundings.
    """
    low, high = float(depth.min()), float(depth.max())
    if high - low <= 1e-6 * max(abs(low), abs(high), 1e-30):
        limit = "All values of the depth map are equal."
        raise InputError("depth", "map", limit, "Save the network's output without rounding it.")
    inside, outside = alpha > 127, alpha == 0
    if outside.any() and float(depth[inside].mean()) < float(depth[outside].mean()):
        limit = "In the depth map, the object is farther away than its surroundings."
        remedy = "If black is near in the map, add --near black; if white is near, remove --near."
        raise InputError("depth", "map", limit, remedy)
    return ((depth - low) / (high - low)).astype(np.float32)


def apply_depth(surface: Surface, depth: Field, object_mask: NDArray[np.bool_]) -> Surface:
    """Replace the front of a surface with a depth map [H,W] in 0..1, in which 1 is nearest.

    The map gets the mean and the standard deviation of the inflated front, because scale and offset
    are unknown.
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
