"""Signed distances of simple solids: functions of points [N,3], negative inside."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Distance = Callable[[Points], NDArray[np.float64]]


def sphere(radius: float, at: Sequence[float] = (0, 0, 0)) -> Distance:
    """A ball around `at`."""
    return lambda p: np.linalg.norm(p - at, axis=1) - radius


def ellipsoid(radii: Sequence[float], at: Sequence[float] = (0, 0, 0)) -> Distance:
    """An ellipsoid with its axes along x, y and z; the distance is a lower bound nearby."""

    def distance(p: Points) -> NDArray[np.float64]:
        q = (p - at) / np.asarray(radii)
        length = np.linalg.norm(q, axis=1)
        steep = np.linalg.norm(q / np.asarray(radii), axis=1)
        return length * (length - 1) / np.maximum(steep, 1e-9)

    return distance


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> Distance:
    """All points within `radius` of a line from `start` to `end`."""
    a, along = np.asarray(start, float), np.subtract(end, start).astype(float)

    def distance(p: Points) -> NDArray[np.float64]:
        share = np.clip((p - a) @ along / (along @ along), 0, 1)
        return np.linalg.norm(p - a - share[:, None] * along, axis=1) - radius

    return distance


def box(sides: Sequence[float], at: Sequence[float] = (0, 0, 0), rounded: float = 0.01) -> Distance:
    """A box of full edges `sides` around `at`, its edges rounded."""
    half = np.asarray(sides) / 2 - rounded

    def distance(p: Points) -> NDArray[np.float64]:
        q = np.abs(p - at) - half
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - rounded

    return distance


def torus(ring: float, tube: float, axis: int, at: Sequence[float] = (0, 0, 0)) -> Distance:
    """A ring of radius `ring` about an axis (0 is x), its tube of radius `tube`."""

    def distance(p: Points) -> NDArray[np.float64]:
        q = p - at
        flat = np.linalg.norm(np.delete(q, axis, axis=1), axis=1) - ring
        return np.hypot(flat, q[:, axis]) - tube

    return distance


def turned(profile: Sequence[tuple[float, float]], axis: int = 2) -> Distance:
    """A solid of revolution: (radius, height) along its outline, closed along the axis."""
    right = np.asarray(profile, float)
    outline = np.concatenate([right, right[::-1] * [-1, 1]])

    def distance(p: Points) -> NDArray[np.float64]:
        radius = np.linalg.norm(np.delete(p, axis, axis=1), axis=1)
        return _polygon(np.stack([radius, p[:, axis]], axis=1), outline)

    return distance


def prism(outline: Sequence[tuple[float, float]], depth: float) -> Distance:
    """A flat figure (y, z) of some depth along x."""

    def distance(p: Points) -> NDArray[np.float64]:
        flat, deep = _polygon(p[:, 1:], np.asarray(outline, float)), np.abs(p[:, 0]) - depth / 2
        outside = np.hypot(np.maximum(flat, 0), np.maximum(deep, 0))
        return outside + np.minimum(np.maximum(flat, deep), 0)

    return distance


def without(solid: Distance, hole: Distance) -> Distance:
    """Return the distance from a solid with another solid cut out."""
    return lambda p: np.maximum(solid(p), -hole(p))


def moved(solid: Distance, to: Sequence[float]) -> Distance:
    """A solid shifted."""
    return lambda p: solid(p - to)


def rotated(solid: Distance, azimuth: float) -> Distance:
    """A solid turned about the vertical axis, degrees."""
    a = np.radians(azimuth)
    matrix = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return lambda p: solid(p @ matrix)


def _polygon(p: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distance of points [N,2] to a closed polygon."""
    nearest, sign = np.full(len(p), np.inf), np.ones(len(p))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge, to = b - a, p - a
        length = edge @ edge
        if length < 1e-18:
            continue
        share = np.clip(to @ edge / length, 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(to - share[:, None] * edge, axis=1))
        crosses = (p[:, 1] >= a[1]) != (p[:, 1] >= b[1])
        left = to[:, 0] * edge[1] < to[:, 1] * edge[0]
        sign = np.where(crosses & (left == (edge[1] > 0)), -sign, sign)
    return sign * nearest
