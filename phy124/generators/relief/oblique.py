"""Carves objects seen obliquely, such as furniture and vehicles, out of a box that stands upright.

The image of the box encloses the silhouette, and the silhouette cuts away the rest of the box. So
the object is as deep as the box, and its feet end on the bottom of the box.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.boxes import CORNERS, Cuboid
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.outlines import outline_of, solidity
from phy124.generators.relief.surface import Surface, View

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
DIRECTIONS = 36
"""Number of directions in which the extents of box and silhouette are compared."""
STARTS = [(yaw, pitch) for yaw in (20.0, 45.0, 70.0) for pitch in (10.0, 25.0)]
"""Directions of the box from which the fit starts [degrees]."""
OUTLYING = 0.02
"""Extents that differ by more than this fraction of the object's size have a reduced weight."""
EMPTY = 0.25
"""Weight of parts of the box above the silhouette, because objects seldom fill the upper edges."""
YAW, PITCH = (15.0, 75.0), (3.0, 30.0)
"""Limits of the angle between the front of a box and the image, and of the elevation [degrees]."""
MISFIT = 0.012
"""Largest root mean square difference of the extents, relative to the object's size."""
OVERLAP = 0.87
"""Smallest overlap (IoU) of the image of the box with the convex hull of the silhouette."""
ELONGATED = 5.0
"""Largest ratio of the longest to the shortest side of a box."""
SOLID = 0.5
"""Smallest area of the silhouette, relative to the convex hull; thin legs would become walls."""
STRAIGHT, ROUGH, SHORTEST = 0.4, 1.5, 0.08
"""Smallest fraction of the outline in straight edges of three directions, largest distance of the
outline from an edge [pixels], and smallest length of an edge, relative to the object's size.
"""
ALIKE = 4
"""Largest angle between edges of one direction [degrees]."""
FOOT = 0.02
"""Smallest height of a gap between feet, and smallest difference of the rows in which near and far
feet end, relative to the object's height.
"""


def find_oblique(object_mask: Mask, view: View) -> Cuboid | None:
    """Return the box around an object whose silhouette [H,W] shows two sides; None for others.

    Such an object has straight edges of few directions, and several feet. In the image, its near
    feet are lower than its far feet.
    """
    likely = solidity(object_mask) > SOLID and _has_feet(object_mask) and _is_straight(object_mask)
    return _fit_around(object_mask, view) if likely else None


def carve(box: Cuboid, alpha: Field) -> Surface:
    """Return the surface of the part of a box that the camera sees inside a silhouette [H,W]."""
    view, inside = box.view, alpha > 0.5
    y, x = np.mgrid[: alpha.shape[0], : alpha.shape[1]].astype(np.float64)
    x, y = x - view.middle[0], y - view.middle[1]
    # The point of a view ray at z is start + z * along.
    start = (np.stack([x, y, np.zeros_like(x)], axis=2) - box.centre) @ box.turn
    along = np.stack([-x / view.distance, -y / view.distance, np.ones_like(x)], axis=2) @ box.turn
    along = np.where(np.abs(along) < 1e-6, 1e-6, along)
    faces = np.stack([(side * box.half - start) / along for side in (-1, 1)])
    far, near = faces.min(axis=0).max(axis=2), faces.max(axis=0).min(axis=2)
    # A few rays miss the box.
    nearest = nearest_of(near > far)[1]
    near, far = near[nearest], far[nearest]
    half = np.maximum((near - far) / 2, 1.0)
    distance = np.where(inside, nearest_of(~inside)[0] - 0.5, 0.5 - nearest_of(inside)[0])
    deepest = float(half[inside].max())
    edge = np.clip(distance / 2.0, -1, 1)
    rounded = deepest * np.sign(edge) * (1 - (1 - np.abs(edge)) ** 2)
    w = np.minimum(half, np.maximum(rounded, 0)) ** 2 + np.minimum(distance, 0) * deepest
    return Surface.of(
        scipy.ndimage.gaussian_filter(w, 1.0), scipy.ndimage.gaussian_filter((near + far) / 2, 1.0)
    )


def _has_feet(object_mask: Mask) -> bool:
    columns = object_mask.any(axis=0)
    rows = np.flatnonzero(object_mask.any(axis=1))
    lowest = len(object_mask) - 1 - object_mask[::-1].argmax(axis=0)[columns]
    least = FOOT * (np.ptp(rows) + 1)
    feet, _ = scipy.signal.find_peaks(np.pad(lowest, 1, constant_values=rows[0]), prominence=least)
    return len(feet) > 1 and bool(np.ptp(lowest[feet - 1]) > least)


def _is_straight(object_mask: Mask) -> bool:
    outline = outline_of(object_mask)
    size = float(np.ptp(outline[:, 0], axis=0).max())
    corners = cv2.approxPolyDP(outline, ROUGH, closed=True)[:, 0].astype(np.float64)
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T)
    long = lengths > SHORTEST * size
    directions = np.degrees(np.arctan2(edges[long, 1], edges[long, 0])).astype(int) % 180
    total = np.bincount(directions, lengths[long], 180)
    straight = 0.0
    for _ in range(3):
        near = scipy.ndimage.convolve1d(total, np.ones(2 * ALIKE + 1), mode="wrap")
        straight += near.max()
        total[(near.argmax() + np.arange(-2 * ALIKE, 2 * ALIKE + 1)) % 180] = 0
    return bool(straight > STRAIGHT * cv2.arcLength(outline, closed=True))


def _fit_around(object_mask: Mask, view: View) -> Cuboid | None:
    """Return the smallest upright box whose image encloses a silhouette [H,W]; None if none fits.

    In every direction, the farthest corner of the box appears as far away as the silhouette.
    """
    hull = cv2.convexHull(outline_of(object_mask))[:, 0]
    places = hull - view.middle[:2]
    angles = np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False)
    across = np.stack([np.cos(angles), np.sin(angles)])
    wanted = (places @ across).max(axis=0)
    size = float(np.ptp(places, axis=0).max())
    low, high = [0, 0, 0, 0, 0, -size, -size], [np.pi / 2, np.pi / 3, 6, 6, 6, size, size]

    def misfit(values: Field) -> Field:
        gaps = ((_project(_box(values, view)) @ across).max(axis=0) - wanted) / size
        return np.where((gaps > 0) & (across[1] < 0), EMPTY * gaps, gaps)

    fits = []
    for start in STARTS:
        values = [*np.radians(start), *[np.log(size / 4)] * 3, 0.0, 0.0]
        fits.append(
            scipy.optimize.least_squares(
                misfit, values, bounds=(low, high), loss="soft_l1", f_scale=OUTLYING, max_nfev=60
            )
        )
    best = min(fits, key=lambda fit: fit.cost)
    box, (yaw, pitch) = _box(best.x, view), np.degrees(best.x[:2])
    fitting = np.sqrt(2 * best.cost / DIRECTIONS) < MISFIT
    turned = YAW[0] < yaw < YAW[1] and PITCH[0] < pitch < PITCH[1]
    if not (fitting and turned and box.half.max() < ELONGATED * box.half.min()):
        return None
    corners = cv2.convexHull(np.rint(_project(box) + view.middle[:2]).astype(np.int32))
    drawn, whole = (
        cv2.fillConvexPoly(np.zeros(object_mask.shape, np.uint8), part, 1) > 0
        for part in (corners, hull)
    )
    overlap = np.count_nonzero(drawn & whole) / np.count_nonzero(drawn | whole)
    return box if overlap > OVERLAP else None


def _box(values: Field, view: View) -> Cuboid:
    """Return the box with yaw, pitch, logarithms of half the sides, x and y of the centre [7]."""
    turn = scipy.spatial.transform.Rotation.from_euler("yx", [values[0], -values[1]]).as_matrix()
    return Cuboid(turn, np.exp(values[2:5]), np.array([*values[5:], 0.0]), view)


def _project(box: Cuboid) -> Field:
    """Return the corners [8,2] of a box in the image, relative to the centre of the view."""
    points = (CORNERS * box.half) @ box.turn.T + box.centre
    return points[:, :2] / (1 - points[:, 2:] / box.view.distance)
