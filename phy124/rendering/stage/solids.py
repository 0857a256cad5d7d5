"""Converts the scene's boundaries to visible solids: plates, walls, boxes and balls."""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Boundary, Container
from phy124.mpm.tracks import Track
from phy124.rendering.stage.frame import Solid
from phy124.rendering.stage.rest import AtRest

LEVEL = 0.999
"""Cosine of the largest slope with which a plane counts as a floor."""
THICK = 0.04
"""Thickness with which walls and plates are rendered [object sizes]."""
WIDE = 1.1
"""Width with which infinite walls and plates are rendered, relative to the object's width."""
LONGEST = 5.0
"""Largest length by which a slope is continued to the floor, in units of the object's width."""
MARGIN = 0.02
"""Distance by which a rendered clamp exceeds the clamped material [object sizes]."""
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class PlacedWall:
    """One wall of the scene that has a simple shape, and the motion of the wall."""

    outline: str
    """Name of the function that returns the distance of points from the wall."""
    shape: NDArray[np.float64]
    """The three vectors that are the parameters of the wall's distance function [3,3], m."""
    track: Track | None
    holds: bool
    """Whether the wall is a clamp, which holds the object instead of stopping it."""
    span: Corners
    """Box outside which an infinite wall is not rendered, m."""
    floor: float = math.inf
    """Height down to which a slope is rendered [m]; if infinite, down to the bottom of its box."""

    @property
    def is_floor(self) -> bool:
        """Whether the wall is a level plane that faces up."""
        return self.outline == "half_space" and not self.holds and self.shape[1][2] > LEVEL

    @property
    def height(self) -> float:
        """Height of the wall's reference point before the wall moves [m]."""
        return float(self.shape[0][2])

    def displacements(self, times: NDArray) -> NDArray[np.float64]:
        """Return the displacement of the wall at each time [T,3], m."""
        return np.zeros((len(times), 3)) if self.track is None else self.track.values(times)

    def present(self, times: NDArray) -> NDArray[np.bool_]:
        """Return whether the wall is present at each time [T]; a clamp may end during the clip."""
        if self.track is None:
            return np.ones(len(times), bool)
        return (times >= self.track.start) & (times < self.track.end)

    def solid(self) -> Solid:
        """Return the solid to render, in its initial position; for a clamp, the clamped box."""
        return _between(*self.span) if self.holds else SHAPES[self.outline](self)


def place_walls(boundaries: Sequence[Boundary], body: AtRest) -> list[PlacedWall]:
    """Split boundaries into simple walls; place each wall around the objects on which it acts."""
    walls = [wall for boundary in boundaries for wall in _walls(boundary, body)]
    # Slopes are drawn down to the floor, because material may slide along them to the floor.
    floors = [wall.height for wall in walls if wall.is_floor]
    return [replace(wall, floor=max(floors, default=math.inf)) for wall in walls]


def _walls(boundary: Boundary, body: AtRest) -> Iterator[PlacedWall]:
    rest = body.targets_of(boundary.object)
    contains = isinstance(boundary, Container)
    span = span_container(boundary, body) if contains else _around(*_corners(rest))
    for part in boundary.parts():
        outline, shape = _shape(part, body)
        if shape is not None:
            wall = PlacedWall(outline, shape, part.track(body), part.holds, span)
            yield replace(wall, span=_clamped_span(wall, rest)) if part.holds else wall


def span_container(container: Container, body: AtRest) -> Corners:
    """Return the box that is drawn for a container around the objects on which it acts [m].

    The box ends slightly above the objects at rest, and open sides end at 2 object sizes.
    """
    low, high = _corners(body.targets_of(container.object))
    size = float((high - low).max())
    room = size * np.array([2.0, 2.0, 0.1])
    inside = (np.array(container.inside.lower), np.array(container.inside.upper))
    return np.maximum(inside[0], low - 2 * size), np.minimum(inside[1], high + room)


def _corners(points: NDArray) -> Corners:
    return points.min(axis=0), points.max(axis=0)


def _shape(part: Boundary, body: AtRest) -> tuple[str, NDArray[np.float64] | None]:
    """Return the shape and the geometry to render. A plug-in with another distance function is
    rendered as its bounding box, if the box is finite.
    """
    with suppress(NotImplementedError, AttributeError):
        if (outline := part.outline()) in SHAPES:
            return outline, np.array(part.geometry(body), float)
    low, high = np.array(part.extent(cast(Any, body)), float)
    if not np.isfinite([low, high]).all():
        return "box", None
    return "box", np.stack([(low + high) / 2, (high - low) / 2, np.zeros(3)])


def _around(low: NDArray, high: NDArray) -> Corners:
    middle, half = (low + high) / 2, (high - low) / 2
    half[:2] = WIDE * half[:2].max()
    half[2] *= 1.1
    return middle - half, middle + half


def _clamped_span(wall: PlacedWall, rest: NDArray) -> Corners:
    point, second, third = wall.shape
    if wall.outline == "half_space":
        inside = (rest - point) @ second <= 0
    else:
        half = second if wall.outline == "box" else _around_cylinder(second, third)
        inside = np.all(np.abs(rest - point) <= half, axis=1)
    clamped = rest[inside] if inside.any() else rest
    margin = MARGIN * float(np.ptp(rest, axis=0).max()) * np.array([1.0, 1.0, 0.0])
    return clamped.min(axis=0) - margin, clamped.max(axis=0) + margin


def _around_cylinder(axis: NDArray, sizes: NDArray) -> NDArray[np.float64]:
    """Return the half sizes of a cylinder's bounding box; `sizes` is (radius, half length)."""
    return np.where(np.abs(axis) > 0.5, sizes[1], sizes[0])


def _panel(wall: PlacedWall) -> Solid:
    """Return the slab that shows a plane; a slope is continued downhill to the floor."""
    point, normal, _ = wall.shape
    low, high = wall.span
    middle, half = (low + high) / 2, (high - low) / 2
    axes = _frame_of(normal)
    thick = THICK * float((high - low).max()) / WIDE
    on_face = middle - ((middle - point) @ normal) * normal
    sizes = np.array([thick / 2, *(np.abs(axes[1:]) @ half)])
    if 1 - LEVEL < normal[2] < LEVEL:
        below = (on_face[2] - wall.floor) / axes[2, 2] - sizes[2]
        below = np.clip(below, 0.0, LONGEST * float((high - low).max()))
        on_face = on_face - below / 2 * axes[2]
        sizes[2] += below / 2
    return Solid(on_face - normal * thick / 2, axes, sizes)


def _frame_of(normal: NDArray) -> NDArray[np.float64]:
    """Return three perpendicular unit vectors [3,3]. The first is the normal, and the second is
    horizontal if possible.
    """
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < LEVEL else np.array([1.0, 0.0, 0.0])
    second = np.cross(up, normal)
    second /= np.linalg.norm(second)
    return np.stack([normal, second, np.cross(normal, second)])


def _between(low: NDArray, high: NDArray) -> Solid:
    return Solid((low + high) / 2, np.eye(3), np.maximum((high - low) / 2, 1e-9))


def _box(wall: PlacedWall) -> Solid:
    return Solid(wall.shape[0], np.eye(3), np.abs(wall.shape[1]))


def _cylinder(wall: PlacedWall) -> Solid:
    point, axis, sizes = wall.shape
    return Solid(point, np.eye(3), _around_cylinder(axis, sizes))


def _ball(wall: PlacedWall) -> Solid:
    return Solid(wall.shape[0], np.eye(3), np.zeros(3), float(wall.shape[1][0]))


def _capsule(wall: PlacedWall) -> Solid:
    first, second, third = wall.shape
    along = second - first
    length = float(np.linalg.norm(along))
    half = np.array([length / 2, 0.0, 0.0])
    return Solid((first + second) / 2, _frame_of(along / length), half, float(third[0]))


SHAPES: dict[str, Any] = {
    "half_space": _panel,
    "box": _box,
    "cylinder": _cylinder,
    "sphere": _ball,
    "capsule": _capsule,
}
"""Functions that return the solid to render, by the name of the distance function."""


def floor_heights(
    walls: Sequence[PlacedWall], rest: NDArray, times: NDArray
) -> NDArray[np.float64]:
    """Return the height of the floor at each time [T], m.

    The floor is the scene's highest horizontal plane that faces up. If there is no such plane, the
    floor is at the lowest point of the object at rest.
    """
    levels = [wall for wall in walls if wall.is_floor]
    if not levels:
        return np.full(len(times), rest[:, 2].min())
    heights = [wall.height + wall.displacements(times)[:, 2] for wall in levels]
    return np.max(heights, axis=0)
