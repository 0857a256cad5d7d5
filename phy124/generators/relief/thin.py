"""Recognises objects with parts that are thinner than wide: wings, fish, and wheels.

Wings, pairs of lenses and pairs of hands are symmetric, with notches in the middle of the upper and
lower edges. A fish becomes narrower towards a tail, whose fin is higher again. Bicycles stand on a
disc at each end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.flat import limit_thickness, stands_on_feet

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
FEWEST = 16
"""Smallest width and height of an examined silhouette [pixels]."""
SYMMETRIC = 0.85
"""Smallest overlap (IoU) of wings with their mirror image."""
LEANING = 15.0
"""Largest angle between the wings' axis and the vertical [degrees]."""
NOTCH = 0.045
"""Smallest mean depth of a notch, relative to the wings' height."""
NOTCHED = 0.4
"""Width of a notch, relative to the wings' width."""
OUTER = 0.33
"""Distance from the axis to the beginning of a wing, relative to the whole width."""
OUTWARD = 0.5
"""Smallest fraction of the silhouette that belongs to wings."""
FILLED = 0.55
"""Smallest area of a silhouette with wings, relative to the convex hull."""
LOWEST = 0.8
"""Smallest ratio of width to height of wings."""
WIDE = 1.5
"""Smallest ratio of width to height of wide wings."""
COMPACT = (0.3, 0.85)
"""Limits of the silhouette's mean height near the axis, relative to the wings' height. The lower
limit does not apply to wide wings. Faces and buses are higher at the axis.
"""
RADIUS = 0.265
"""Largest radius of a disc inside wings, relative to the object's size."""
SHEET = 0.025
"""Half thickness of wings, relative to the object's size."""
BODY = 0.06
"""Half thickness of the body between wings, relative to the object's size."""
NARROW = 0.6
"""Largest height of the narrow part in front of a fish's tail, relative to the body's height."""
FIN = 1.4
"""Smallest height of the tail's fin, relative to the narrow part's height."""
FINNED = (0.25, 0.9)
"""Limits of the height of the tail's fin, relative to the body."""
FORE = 0.53
"""Largest distance of a fish's highest part from the nose, relative to the fish's length."""
TAIL = (0.6, 0.93)
"""Limits of the narrow part's distance from the nose, relative to the fish's length."""
NOSE = 0.5
"""Largest height of a fish's nose, relative to the body."""
KEEL = 0.4
"""Largest width of the lowest rows of a fish, relative to the fish's length."""
LONG = 1.1
"""Smallest ratio of a fish's length to its height."""
DEEP = 0.5
"""Smallest height of a fish's body, relative to the height of the silhouette with fins."""
UNEVEN = 0.08
"""Largest increase of the height between body and tail, relative to the body."""
OBLIQUE = 0.15
"""Largest vertical distance between the middles of tail and body, relative to the fish's height."""
HOLLOW = 0.15
"""Largest empty fraction of a column in a fish. Handles enclose larger gaps."""
FLATTENED = 0.6
"""Thickness of a fish, relative to the fish's height."""
GROUND = 0.08
"""Largest distance of a wheel from the ground, relative to the object's height."""
ROUND = 0.035
"""Largest root mean square distance of a wheel's outline from a circle, relative to the radius."""
ARC = 0.75
"""Width of the arc that is compared with a circle, relative to the radius."""
RADII = (0.08, 0.36)
"""Smallest radius of a wheel, relative to the object's height, and largest radius, relative to the
object's size.
"""
AROUND = 1.12
"""Radius of the examined circle around a wheel, relative to the wheel's radius."""
FREE = 0.55
"""Smallest fraction of the circle around a wheel that is outside the silhouette."""
APART = 1.25
"""Smallest distance between two wheels, relative to the sum of the radii."""
LARGE = 0.18
"""Smallest radius of the larger wheel, relative to the object's height."""
AT_ENDS = 0.08
"""Largest distance of a wheel from the object's end, relative to the object's width."""
TYRE = 0.2
"""Half thickness of a wheel, relative to the radius."""


@dataclass(frozen=True)
class Wings:
    """Two sheets, one at each side of a narrow body."""

    axis: tuple[float, float]
    """Column and row of a point on the axis."""
    lean: float
    """Angle between the axis and the vertical [radians]."""
    size: int
    """Longest side of the silhouette [pixels]."""
    alike: ClassVar[bool] = True
    """Whether front and back look alike."""

    def flatten(self, half: Field) -> Field:
        """Limit squared half thicknesses [H,W] to the half thicknesses of the sheets and the
        body.
        """
        y, x = np.mgrid[: half.shape[0], : half.shape[1]]
        away = (x - self.axis[0]) * np.cos(self.lean) + (y - self.axis[1]) * np.sin(self.lean)
        bulge = (BODY - SHEET) * np.exp(-((away / (BODY * self.size)) ** 2))
        return limit_thickness(half, self.size * (SHEET + bulge))


@dataclass(frozen=True)
class Fish:
    """A fish seen from the side."""

    alike: ClassVar[bool] = True

    def flatten(self, half: Field) -> Field:
        """Reduce squared half thicknesses [H,W]."""
        return half * FLATTENED**2


@dataclass(frozen=True)
class Wheel:
    """A disc that stands on the ground, in pixels."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Wheels:
    """The two wheels of a bicycle."""

    left: Wheel
    right: Wheel
    alike: ClassVar[bool] = True

    def flatten(self, half: Field) -> Field:
        """Limit squared half thicknesses [H,W] inside the wheels."""
        y, x = np.mgrid[: half.shape[0], : half.shape[1]]
        for wheel in (self.left, self.right):
            beyond = np.hypot(x - wheel.x, y - wheel.y) - wheel.radius
            half = limit_thickness(half, TYRE * wheel.radius + np.maximum(beyond, 0.0))
        return half


def find_thin(object_mask: Mask) -> Wings | Fish | Wheels | None:
    """Return the thin parts of a silhouette [H,W], or None."""
    if min(_crop(object_mask).shape) < FEWEST:
        return None
    return find_wings(object_mask) or find_fish(object_mask) or find_wheels(object_mask)


def find_wings(object_mask: Mask) -> Wings | None:
    """Return the wings in a silhouette [H,W], or None."""
    folded = _fold(object_mask)
    if folded is None:
        return None
    wings, solid = folded
    height, width = solid.shape
    away = np.abs(np.arange(width) - (width - 1) / 2) / (width / 2)
    heights = solid.sum(axis=0)
    middle = heights[away < 0.1].mean() / height
    least = 0.0 if width >= WIDE * height else COMPACT[0]
    radius = cv2.distanceTransform(np.pad(solid, 1).astype(np.uint8), cv2.DIST_L2, 5).max()
    if (
        width < LOWEST * height
        or heights[away > OUTER].sum() < OUTWARD * heights.sum()
        or not least <= middle <= COMPACT[1]
        or radius > RADIUS * wings.size
    ):
        return None
    places = np.argwhere(solid)[:, ::-1].astype(np.int32)
    hull = cv2.fillConvexPoly(np.zeros(solid.shape, np.uint8), cv2.convexHull(places), 1) > 0
    near = away < NOTCHED
    notches = [
        (part.argmax(axis=0) - whole.argmax(axis=0))[near & solid.any(axis=0)].mean() / height
        for part, whole in ((solid, hull), (solid[::-1], hull[::-1]))
    ]
    filled = heights.sum() / np.count_nonzero(hull)
    return wings if min(notches) > NOTCH and filled > FILLED else None


def _fold(object_mask: Mask) -> tuple[Wings, Mask] | None:
    """Turn a symmetric silhouette until the axis is vertical; return None for other silhouettes.

    The centroid and a principal axis of a symmetric silhouette are on the axis of symmetry.
    """
    y, x = np.nonzero(object_mask)
    middle = float(x.mean()), float(y.mean())
    u, v = x - middle[0], y - middle[1]
    angle = 0.5 * float(np.arctan2(2 * (u * v).mean(), (u**2).mean() - (v**2).mean()))
    size = max(int(np.ptp(x)), int(np.ptp(y))) + 1
    for lean in (0.0, angle) if abs(angle) < np.radians(LEANING) else (0.0,):
        reach = int(np.hypot(*object_mask.shape)) // 2
        cosine, sine = np.cos(lean), np.sin(lean)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        back = np.column_stack([turn, middle - turn @ [reach, reach]])
        turned = cv2.warpAffine(
            object_mask.astype(np.uint8) * 255,
            back,
            (2 * reach + 1,) * 2,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        solid = turned > 127
        both = np.count_nonzero(solid & solid[:, ::-1])
        if both > SYMMETRIC * (2 * np.count_nonzero(solid) - both):
            rows = np.flatnonzero(solid.any(axis=1))
            columns = np.flatnonzero((solid | solid[:, ::-1]).any(axis=0))
            box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            return Wings(middle, lean, size), solid[box]
    return None


def find_fish(object_mask: Mask) -> Fish | None:
    """Return a fish if a silhouette [H,W] shows one."""
    solid = _crop(object_mask)
    height, width = solid.shape
    keel = np.count_nonzero(solid[-max(2, round(0.03 * height))])
    if width < LONG * height or keel > KEEL * width or stands_on_feet(solid):
        return None
    return Fish() if _swims(solid) or _swims(solid[:, ::-1]) else None


def _swims(solid: Mask) -> bool:
    """Whether a silhouette [H,W] without an empty border shows a fish that faces left."""
    height, width = solid.shape
    filled = solid.sum(axis=0)
    heights = scipy.ndimage.uniform_filter1d(filled.astype(float), max(3, width // 60))
    body, last = int(heights.argmax()), int(TAIL[1] * width)
    first = int(TAIL[0] * width)
    tail = first + int(heights[first:last].argmin())
    narrow, fin, highest = heights[tail], heights[tail:].max(), heights[body]
    if body > FORE * width or tail in (first, last - 1) or narrow <= 0:
        return False
    upper, lower = solid.argmax(axis=0), height - solid[::-1].argmax(axis=0)
    middle, between = (upper + lower) / 2, heights[body : tail + 1]
    rise = (np.maximum.accumulate(between[::-1])[::-1] - between).max()
    return bool(
        narrow < NARROW * highest
        and fin > FIN * narrow
        and FINNED[0] * highest < fin < FINNED[1] * highest
        and heights[: max(1, round(0.05 * width))].mean() < NOSE * highest
        and highest > DEEP * height
        and rise < UNEVEN * highest
        and abs(middle[tail] - middle[body]) < OBLIQUE * height
        and (filled / (lower - upper))[[tail, body]].min() > 1 - HOLLOW
    )


def find_wheels(object_mask: Mask) -> Wheels | None:
    """Return the wheels of a bicycle in a silhouette [H,W], or None."""
    rows, columns = (np.flatnonzero(object_mask.any(axis=axis)) for axis in (1, 0))
    height, (start, end) = np.ptp(rows) + 1, columns[[0, -1]]
    wheels = circles_on_ground(object_mask)
    if len(wheels) < 2:
        return None
    left, right = wheels[0], wheels[-1]
    inset = max(abs(left.x - left.radius - start), abs(right.x + right.radius - end))
    apart = right.x - left.x > APART * (left.radius + right.radius)
    large = max(left.radius, right.radius) > LARGE * height
    return Wheels(left, right) if apart and large and inset < AT_ENDS * (end - start) else None


def circles_on_ground(object_mask: Mask, free: float = FREE) -> list[Wheel]:
    """Return the discs on which a silhouette [H,W] stands, from left to right.

    At least the fraction `free` of a circle around each disc is outside the silhouette.
    """
    solid, size = _crop(object_mask), max(_crop(object_mask).shape)
    rows, columns = (np.flatnonzero(object_mask.any(axis=axis)) for axis in (1, 0))
    pad, height = size // 4, len(solid)
    solid = np.pad(solid, pad)
    lowest = np.where(solid.any(axis=0), len(solid) - 1 - solid[::-1].argmax(axis=0), -1.0)
    near = int(0.12 * size) | 1
    ground = lowest >= lowest.max() - GROUND * height
    touching = ground & (lowest == scipy.ndimage.maximum_filter1d(lowest, near))
    parts, _ = scipy.ndimage.label(touching)  # pyright: ignore
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    wheels = []
    for (part,) in scipy.ndimage.find_objects(parts):  # pyright: ignore
        x, y = (part.start + part.stop - 1) / 2, float(lowest[part.start])
        radius = _radius_below(lowest, x, y, RADII[0] * height, RADII[1] * size)
        if radius is None:
            continue
        across, down = (
            x + AROUND * radius * np.cos(turn),
            y - radius + AROUND * radius * np.sin(turn),
        )
        place = [
            np.rint(v).astype(int).clip(0, n - 1)
            for v, n in zip((down, across), solid.shape, strict=True)
        ]
        if 1 - solid[tuple(place)].mean() >= free:
            wheels.append(Wheel(x - pad + columns[0], y - radius - pad + rows[0], radius))
    return wheels


def _radius_below(lowest: Field, x: float, y: float, least: float, most: float) -> float | None:
    """Return the radius of the largest disc above a lower outline [W]; None if there is none."""
    largest = None
    for radius in np.arange(least, most):
        columns = np.arange(int(np.ceil(x - ARC * radius)), int(x + ARC * radius) + 1)
        if columns[0] < 0 or columns[-1] >= len(lowest):
            break
        arc = y - radius + np.sqrt(radius**2 - (columns - x) ** 2)
        if np.sqrt(np.mean((lowest[columns] - arc) ** 2)) < ROUND * radius:
            largest = columns
    if largest is None:
        return None
    outer = largest[np.abs(largest - x) > np.ptp(largest) / 4]
    rise = np.maximum(y - lowest[outer], 1.0)
    return float(np.median(((outer - x) ** 2 + rise**2) / (2 * rise)))


def _crop(object_mask: Mask) -> Mask:
    rows, columns = (np.flatnonzero(object_mask.any(axis=axis)) for axis in (1, 0))
    return object_mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
