"""Fits a box to an outline with six corners, such as a cuboid with an edge in front.

The corners' twelve coordinates determine the box's rotation, position and three side lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.back import most_common
from phy124.generators.relief.outlines import outline_of
from phy124.generators.relief.shell import DRAWN_IN
from phy124.generators.relief.surface import View

Field = NDArray[np.float64]
TOLERANCES = 0.01, 0.007, 0.004
"""Tolerances of the hexagon, relative to the outline's length."""
OVERLAP = 0.98
"""Smallest overlap (IoU) of the hexagon with the silhouette."""
ROUGH = 1.5
"""Largest distance of a rounded outline from straight edges [pixels]."""
LONG = 0.06
"""Smallest length of an edge between rounded corners, relative to the outline's length."""
BLUNT = 8.0
"""Smallest angle between two edges with a rounded corner [degrees]."""
ROUNDED = 0.95
"""Smallest overlap (IoU) of the hexagon with a rounded outline."""
LOWEST_VIEW = 10.0
"""Smallest elevation from which a rounded box is seen [degrees]."""
ELONGATED = 4.0
"""Largest ratio of the longest to the shortest side of a rounded box."""
YAWS, PITCHES = (20.0, 45.0, 70.0), (-2.0, -25.0, -50.0)
"""View directions from which the fit starts [degrees]; boxes are assumed to be seen from above."""
MISFIT = 7.0
"""Largest root mean square distance between the corners of box and hexagon [pixels]; the object's
longest side has 248 pixels.
"""
FARTHER, WORST = (2.0, 4.0, 8.0), 14.0
"""Distances of cameras with a weaker perspective, relative to the front camera, and largest misfit
at which these cameras are tried [pixels].
"""
PRECISE = 1e-3
"""Relative change at which a fit ends."""
LONGEST = 12.0
"""Largest ratio of the box's longest to shortest side."""
ASKEW = 8.0
"""Largest angle between the vertical and an edge of an upright box in the image [degrees]."""
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)


@dataclass(frozen=True, eq=False)
class Cuboid:
    """A box in projected coordinates."""

    turn: Field
    """Rotation from the box's axes to the camera's [3,3]."""
    half: Field
    """Half of the side lengths [3], pixels."""
    centre: Field
    """Centre [3], pixels."""
    view: View
    """Camera that sees the object's silhouette."""

    def spread(self, count: int) -> tuple[Field, Field, float]:
        """Distribute points evenly over the faces of the box.

        Returns:
            Points in projected coordinates [N,3], outward unit normals [N,3], and the spacing of
            the points.
        """
        half = np.maximum(self.half - DRAWN_IN, self.half / 2)
        area = 8 * (half.prod() / half).sum()
        pitch = float(np.sqrt(area / count))
        edge = pitch * (4 / 3) ** 0.25  # each point of the lattice has the area pitch^2
        points, normals = [], []
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            rows, columns = (
                np.linspace(-reach, reach, max(2, round(2 * reach / step)))
                for reach, step in ((half[v], edge * 3**0.5 / 2), (half[u], edge))
            )
            for side in (-1, 1):
                face = np.zeros((len(rows), len(columns), 3))
                face[..., axis] = side * half[axis]
                face[..., v] = rows[:, None]
                # The points form a triangular lattice: every second row is shifted by half a
                # spacing.
                shift = np.where(np.arange(len(rows)) % 2, edge / 2, 0.0)[:, None]
                face[..., u] = np.minimum(columns + shift, half[u])
                points.append(face.reshape(-1, 3))
                normals.append(np.tile(side * np.eye(3)[axis], (points[-1].shape[0], 1)))
        placed = np.concatenate(points) @ self.turn.T + self.centre
        return placed, np.concatenate(normals) @ self.turn.T, pitch

    def upright(self) -> Field:
        """Return the rotation from upright coordinates to the camera's [3,3].

        The box axis that looks most vertical becomes vertical, unless the box is askew or seen from
        below.
        """
        roll, elevation = self._tilt()
        if abs(roll) > np.radians(ASKEW) or elevation < 0:
            return np.eye(3)
        rotation = scipy.spatial.transform.Rotation
        return (rotation.from_euler("z", roll) * rotation.from_euler("x", -elevation)).as_matrix()

    def stands(self) -> bool:
        """Whether the box stands upright, is seen from above, and is not elongated."""
        roll, elevation = np.degrees(self._tilt())
        upright = abs(roll) <= ASKEW and elevation >= LOWEST_VIEW
        return upright and bool(self.half.max() <= ELONGATED * self.half.min())

    def _tilt(self) -> tuple[float, float]:
        axes = self.turn.T * np.where(self.turn[1] > 0, -1, 1)[:, None]
        up = axes[axes[:, 1].argmin()]  # rows point downwards
        return float(np.arctan2(up[0], -up[1])), float(np.arcsin(up[2]))

    def colours(self, points: Field, normals: Field, seen: Field) -> Field:
        """Return colours [N,3]; a hidden face is the mirror image of the opposite face.

        Args:
            points: Projected points [N,3].
            normals: Unit normals [N,3].
            seen: Colours of the image at these points [N,3].
        """
        eye = np.array([0.0, 0.0, self.view.distance])
        visible = ((eye - points) * normals).sum(axis=1) > 0
        colours = np.where(visible[:, None], seen, most_common(seen[visible]))
        places = (points - self.centre) @ self.turn
        axis = np.abs(normals @ self.turn).argmax(axis=1)
        for number in range(3):
            shown, hidden = ((axis == number) & side for side in (visible, ~visible))
            if shown.any() and hidden.any():
                across = np.delete(places, number, axis=1)
                nearest = scipy.spatial.KDTree(across[shown]).query(across[hidden])[1]
                colours[hidden] = seen[shown][nearest]
        return colours


def find_box(object_mask: NDArray[np.bool_], view: View) -> Cuboid | None:
    """Return the box that fits the silhouette [H,W]; None if no box fits.

    Cameras farther away than `view` are also tried, because drawings often have a weak perspective.
    """
    sharp = _hexagon(object_mask)
    corners = rounded_polygon(object_mask, 6) if sharp is None else sharp
    if corners is None:
        return None
    corners = corners - view.middle[:2]
    box, misfit = _fit_box(corners, view)
    if MISFIT < misfit <= WORST:
        farther = [_fit_box(corners, replace(view, distance=f * view.distance)) for f in FARTHER]
        box, misfit = min(farther, key=lambda fit: fit[1])
    if box is None or misfit > MISFIT or box.half.max() > LONGEST * box.half.min():
        return None
    return box if sharp is not None or box.stands() else None


def _fit_box(corners: Field, view: View) -> tuple[Cuboid | None, float]:
    """Return the box that fits corners [6,2] best, and the misfit [pixels]."""
    starts = [_fit(corners, yaw, pitch, view.distance) for yaw in YAWS for pitch in PITCHES]
    fits = [fit for fit in starts if fit is not None]
    if not fits:
        return None, np.inf
    values, misfit = min(fits, key=lambda fit: fit[1])
    turn = scipy.spatial.transform.Rotation.from_rotvec(values[:3]).as_matrix()
    return Cuboid(turn, np.exp(values[3:6]), np.array([*values[6:], 0.0]), view), misfit


def _hexagon(object_mask: NDArray[np.bool_]) -> Field | None:
    """Return the corners [6,2], pixels; None if the silhouette is not a hexagon."""
    hull = cv2.convexHull(outline_of(object_mask))
    length = cv2.arcLength(hull, closed=True)
    for tolerance in TOLERANCES:
        corners = cv2.approxPolyDP(hull, tolerance * length, closed=True)
        if len(corners) == 6 and _covers(object_mask, corners) > OVERLAP:
            return corners[:, 0].astype(np.float64)
    return None


def _covers(object_mask: NDArray[np.bool_], corners: NDArray) -> float:
    drawn = cv2.fillPoly(np.zeros(object_mask.shape, np.uint8), [corners], 1) > 0
    return np.count_nonzero(drawn & object_mask) / np.count_nonzero(drawn | object_mask)


def rounded_polygon(object_mask: NDArray[np.bool_], count: int) -> Field | None:
    """Return the corners [C,2], pixels, of a convex polygon whose `count` corners were rounded.

    The corners are the intersections of the long edges. The result is None if the number of long
    edges differs from `count`, or if the silhouette does not fill the polygon.
    """
    hull = cv2.convexHull(outline_of(object_mask))
    start = cv2.approxPolyDP(hull, ROUGH, closed=True)[:, 0].astype(np.float64)
    edges = np.roll(start, -1, axis=0) - start
    long = np.hypot(*edges.T) > LONG * cv2.arcLength(hull, closed=True)
    if np.count_nonzero(long) != count:
        return None
    start, edges = start[long], edges[long]
    after, gap = np.roll(edges, -1, axis=0), np.roll(start, -1, axis=0) - start
    turning = _cross(edges, after)
    sines = turning / np.hypot(*edges.T) / np.hypot(*after.T)
    if np.abs(sines).min() < np.sin(np.radians(BLUNT)):
        return None
    corners = start + (_cross(gap, after) / turning)[:, None] * edges
    covered = _covers(object_mask, np.rint(corners[:, None]).astype(np.int32))
    return corners if covered >= ROUNDED else None


def _cross(first: Field, second: Field) -> Field:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _project(values: Field, distance: float) -> Field:
    """Return the corners [8,2] from a box's rotation, logarithmic sizes, x and y."""
    turn = scipy.spatial.transform.Rotation.from_rotvec(values[:3]).as_matrix()
    points = (CORNERS * np.exp(values[3:6])) @ turn.T + [*values[6:], 0.0]
    return points[:, :2] / (1 - points[:, 2:] / distance)


def _fit(corners: Field, yaw: float, pitch: float, distance: float) -> tuple[Field, float] | None:
    """Fit a box to corners [6,2] from a start direction; return parameters and misfit [pixels]."""
    turn = scipy.spatial.transform.Rotation.from_euler("yx", [yaw, pitch], degrees=True)
    size = np.ptp(corners, axis=0)
    values = np.array([*turn.as_rotvec(), *[np.log(size.mean() / 3.5)] * 3, *corners.mean(axis=0)])
    drawn = _project(values, distance)
    hull = cv2.convexHull(drawn.astype(np.float32), returnPoints=False)[:, 0].astype(np.intp)
    wanted = cv2.convexHull(corners.astype(np.float32))[:, 0].astype(np.float64)
    if len(hull) != len(wanted):
        return None
    scaled = (drawn - drawn[hull].mean(axis=0)) / np.ptp(drawn[hull], axis=0) * size
    shifts = [np.roll(hull, shift) for shift in range(len(hull))]
    order = min(
        shifts, key=lambda o: float(((scaled[o] - (wanted - wanted.mean(axis=0))) ** 2).sum())
    )
    fit = scipy.optimize.least_squares(
        lambda v: (_project(v, distance)[order] - wanted).ravel(),
        values,
        max_nfev=60,
        ftol=PRECISE,
        xtol=PRECISE,
    )
    return fit.x, float(np.sqrt(2 * fit.cost / len(wanted)))
