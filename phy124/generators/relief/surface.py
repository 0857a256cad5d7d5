"""The closed surface z^2 = w(x, y), and points spread evenly over it.

Coordinates are pixels: x right, y down, z towards the viewer. As an implicit surface it has no
seam: the rim is as regular as any other place.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.ends import End
from phy124.generators.relief.height import nearest_of

Field = NDArray[np.float64]
Neighbours = NDArray[np.intp]
BACK_PITCH = 1.5
"""Spacing of points on the back relative to the front; its colours are smooth."""
OVERHANG = 5.0
"""How far beyond the ends points continue while they are spread, pixels."""
ROUNDS = 6
"""Number of relaxation rounds; the spacing is even to about 10 % after five."""
ALIKE = 3
"""Number of rounds in which the same points count as neighbours; finding them takes longest."""
BLOCK = 4096
"""Points that are pushed at once."""


class Implicit(ABC):
    """The zero set of a function that is positive inside."""

    @abstractmethod
    def gradient(self, points: Field) -> tuple[Field, Field]:
        """F [N] and its gradient [N,3] at points [N,3]."""

    def normals(self, points: Field) -> Field:
        """Outward unit normals [N,3]."""
        _, gradient = self.gradient(points)
        return -gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)

    def inset(self, points: Field, depth: float) -> Field:
        """`depth`, limited to a third of the local radius [N,1], pixels."""
        _, gradient = self.gradient(points)
        # On a ball F = r^2 - |x|^2, whose gradient is twice the radius.
        radius = 0.5 * np.linalg.norm(gradient, axis=1, keepdims=True)
        return np.minimum(depth, radius / 3)

    def project(self, points: Field, rounds: int = 2) -> Field:
        """Points moved onto the surface by Newton steps of at most one pixel each."""
        for _ in range(rounds):
            value, gradient = self.gradient(points)
            step = -(value / np.maximum((gradient**2).sum(axis=1), 1e-9))[:, None] * gradient
            length = np.linalg.norm(step, axis=1, keepdims=True)
            points = points + step / np.maximum(1.0, length)
        return points


@dataclass(frozen=True, eq=False)
class Surface(Implicit):
    """The zero set of F(x, y, z) = w(x, y) - (z - m(x, y))^2."""

    w: Field
    """Squared half thickness [H,W], pixels^2, negative outside."""
    m: Field
    """Depth of the middle between front and back [H,W], pixels."""
    slopes: Field
    """Gradients of w and m along x and y [2,2,H,W]."""

    @classmethod
    def of(cls, w: Field, m: Field | None = None) -> Surface:
        """From squared half thicknesses and middles [H,W], pixels^2 and pixels."""
        m = np.zeros_like(w) if m is None else m
        slopes = [np.gradient(scipy.ndimage.gaussian_filter(field, 0.7))[::-1] for field in (w, m)]
        return cls(w, m, np.asarray(slopes))

    @classmethod
    def seen(cls, w: Field, middle: Field, distance: float) -> Surface:
        """As the camera of `View` sees round parts: it sees less than half of each.

        In pixels, along the rays, a circle of radius h about c is centred at z = p (p - c) / d,
        with p relative to the picture's middle; and p - c is -grad(w) / 2.
        """
        dy, dx = np.gradient(scipy.ndimage.gaussian_filter(w, 1.5))
        y, x = np.mgrid[: len(w), : w.shape[1]]
        x, y = x - middle[0], y - middle[1]
        limit = np.hypot(x, y) * np.sqrt(w.max())
        m = np.clip(-(x * dx + y * dy) / 2, -limit, limit) / distance
        m = scipy.ndimage.gaussian_filter(m[nearest_of(w > 0)[1]], 2.0)
        return cls.of(w / (1 + np.maximum(w, 0) / distance**2), m)

    @cached_property
    def _fields(self) -> Field:
        return np.stack([self.w, self.m, *self.slopes.reshape(4, *self.w.shape)], axis=2)

    def middle(self, points: Field) -> Field:
        """m at points [N,3 or 2]."""
        return scipy.ndimage.map_coordinates(self.m, points[:, 1::-1].T, order=1, mode="nearest")

    def gradient(self, points: Field) -> tuple[Field, Field]:
        """F [N] and its gradient [N,3] at points [N,3]."""
        value, middle, wx, wy, mx, my = interpolated(self._fields, points).T
        z = points[:, 2] - middle
        # A row per axis in memory, where sums over the axes take a fraction of the time.
        return value - z * z, np.stack([wx + 2 * z * mx, wy + 2 * z * my, -2 * z]).T

    def section(self, y: float) -> float:
        """Area of the horizontal cross-section of the object at y, pixels^2."""
        row = self.w[min(int(y), len(self.w) - 1)]
        return float(2 * np.sqrt(np.maximum(row, 0)).sum())


def interpolated(fields: Field, points: Field) -> Field:
    """Several fields [H,W,C] at points [N,3 or 2], linear between pixels, constant beyond: [N,C].

    As `map_coordinates` would, but the weights are the same for all fields: a quarter of the time.
    """
    height, width, _ = fields.shape
    x, y = np.clip(points[:, 0], 0, width - 1), np.clip(points[:, 1], 0, height - 1)
    column = np.minimum(x.astype(np.int32), width - 2)
    row = np.minimum(y.astype(np.int32), height - 2)
    right, down = x - column, y - row
    weights = np.empty((len(points), 2, 2))
    weights[:, 0, 0], weights[:, 0, 1] = (1 - down) * (1 - right), (1 - down) * right
    weights[:, 1, 0], weights[:, 1, 1] = down * (1 - right), down * right
    corners = (row * width + column)[:, None] + np.array([0, 1, width, width + 1], np.int32)
    every = np.arange(0, 4 * len(points) + 1, 4, dtype=np.int32)
    shape = len(points), height * width
    matrix = scipy.sparse.csr_array((weights.ravel(), corners.ravel(), every), shape=shape)
    return matrix @ fields.reshape(height * width, -1)


def pitch_factor(normals: Field) -> Field:
    """Wanted spacing relative to the front [N]: 1 where visible from the front, wider elsewhere."""
    return np.interp(-normals[:, 2], [0.0, 0.5], [1.0, BACK_PITCH])


def spread(
    surface: Surface,
    ends: Sequence[End],
    count: int,
    rng: np.random.Generator,
    alive: Callable[[], None] = lambda: None,
) -> tuple[Field, Field, Field, float]:
    """Points spread evenly over the part between the flat ends.

    Args:
        surface: The surface.
        ends: Where the object is cut off flat.
        count: Number of points that walls and flat ends together get, approximately.
        rng: Random numbers.
        alive: Called between rounds; may raise.

    Returns:
        Positions [N,3], unit normals [N,3], spacing [N] and the front's spacing, pixels. A few
            points lie beyond the ends, where the caller cuts.
    """
    trial = _scatter(surface, 1.0, rng)
    walls = np.count_nonzero(_between(trial, ends))
    faces = sum(surface.section(end.corner) for end in ends)
    pitch = float(np.sqrt((walls + faces) / count))
    points = _scatter(surface, pitch, rng)
    points = points[_between(points, ends, OVERHANG)]

    def wanted(normals: Field) -> Field:
        return pitch * pitch_factor(normals)

    points = settled(surface, points, wanted, alive)
    _, spacing = relaxed(surface, points, wanted)
    return points, surface.normals(points), spacing, pitch


def _between(points: Field, ends: Sequence[End], by: float = 0.0) -> NDArray[np.bool_]:
    """Which points lie at most so many pixels beyond the ends."""
    kept = np.ones(len(points), bool)
    for end in ends:
        kept &= ~end.beyond(points[:, 1], by)
    return kept


def _scatter(surface: Surface, pitch: float, rng: np.random.Generator) -> Field:
    """Random points, on average one per pitch^2 of the front's area.

    One candidate in every cube that the surface passes through is then thinned out, since a plane
    of normal n passes through |nx| + |ny| + |nz| cubes per square.
    """
    corner, low, high = _columns(surface.w, pitch)
    first, last = np.floor(low / pitch).astype(int), np.floor(high / pitch).astype(int)
    layers = last - first + 1
    column = np.repeat(np.arange(len(corner)), layers)
    layer = np.arange(len(column)) - np.repeat(np.cumsum(layers) - layers, layers) + first[column]
    flat = np.concatenate([corner[column], layer[:, None] * pitch], axis=1)
    halves = []
    for side in (1.0, -1.0):
        half = flat + pitch * rng.random(flat.shape)
        half[:, 2] = side * half[:, 2] + surface.middle(half)
        halves.append(half)
    points = surface.project(np.concatenate(halves), rounds=4)
    value, gradient = surface.gradient(points)
    landed = np.abs(value) < 0.5 * np.linalg.norm(gradient, axis=1)
    normals = surface.normals(points)
    chance = 1 / (np.abs(normals).sum(axis=1) * pitch_factor(normals) ** 2)
    return points[landed & (rng.random(len(points)) < chance)]


def _columns(w: Field, pitch: float) -> tuple[Field, Field, Field]:
    """Square columns that meet the surface: corner [M,2], lowest and highest |z| in each [M]."""
    height, width = w.shape
    x, y = np.arange(0, width - 1 - pitch, pitch), np.arange(0, height - 1 - pitch, pitch)
    fine = [
        scipy.ndimage.map_coordinates(
            w, np.meshgrid(y + a * pitch, x + b * pitch, indexing="ij"), order=1
        )
        for a in (0.0, 0.5, 1.0)
        for b in (0.0, 0.5, 1.0)
    ]
    low, high = np.stack(fine).min(axis=0), np.stack(fine).max(axis=0)
    row, column = np.nonzero(high > 0)
    nearest, deepest = np.sqrt(np.maximum(low, 0)[row, column]), np.sqrt(high[row, column])
    return np.stack([x[column], y[row]], axis=1), nearest, deepest


def settled(
    surface: Implicit,
    points: Field,
    spacing_at: Callable[[Field], Field],
    alive: Callable[[], None] = lambda: None,
) -> Field:
    """Points [N,3] after all rounds of relaxation.

    Args:
        surface: The surface.
        points: The points.
        spacing_at: The wanted spacing [N] where the surface has these normals [N,3].
        alive: Called before each round, and after the last one; may raise.
    """
    for _ in range(ROUNDS // ALIKE):
        near = neighbours(points)
        for _ in range(ALIKE):
            alive()
            points, _ = relaxed(surface, points, spacing_at, near)
    alive()
    return points


def relaxed(
    surface: Implicit,
    points: Field,
    spacing_at: Callable[[Field], Field],
    near: Neighbours | None = None,
) -> tuple[Field, Field]:
    """Points [N,3] pushed apart along a surface, and the mean distance to their neighbours [N].

    Args:
        surface: The surface.
        points: The points.
        spacing_at: The wanted spacing [N] where the surface has these normals [N,3].
        near: Their neighbours, if they are known.
    """
    near = neighbours(points) if near is None else near
    normals = surface.normals(points)
    wanted, move, spacing = spacing_at(normals), np.empty_like(points), np.empty(len(points))
    # A row per axis in memory, and some points at a time, of which everything fits into a cache.
    rows = np.ascontiguousarray(points.T), np.ascontiguousarray(normals.T)
    for start in range(0, len(points), BLOCK):
        some = slice(start, start + BLOCK)
        move[some], spacing[some] = _pushed(*rows, wanted, near, some)
    return surface.project(points + move), spacing


def neighbours(points: Field) -> Neighbours:
    """The seven nearest to each point [N,7], nearest first; fewer if there are fewer points."""
    tree = scipy.spatial.KDTree(points, leafsize=16, balanced_tree=False)  # half the time to build
    return np.asarray(tree.query(points, k=min(8, len(points)), workers=-1)[1])[:, 1:]


def _pushed(
    points: Field, normals: Field, wanted: Field, near: Neighbours, some: slice
) -> tuple[Field, Field]:
    """How far some points are pushed [M,3], and the mean distance to their neighbours [M].

    Points and normals are [3,N].
    """
    wanted, near, own = wanted[some, None], near[some], normals[:, some]
    apart = [axis[some, None] - axis[near] for axis in points]
    distance = np.sqrt(apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2)
    # In thin parts the nearest points may lie on the other side; those do not count.
    x, y, z = (axis[some, None] * axis[near] for axis in normals)
    same = x + y + z > 0.3
    push = np.where(same, np.maximum(0, 1 - distance / (1.25 * wanted)), 0.0) * wanted
    push *= 0.45 / np.maximum(distance, 1e-9)
    move = np.stack([(push * axis).sum(axis=1) for axis in apart])
    move -= (move * own).sum(axis=0) * own
    counted = np.maximum(same[:, :6].sum(axis=1), 1)
    spacing = np.where(same, distance, 0.0)[:, :6].sum(axis=1) / counted
    wanted = wanted[:, 0]
    return move.T, np.clip(np.where(spacing > 0, spacing, wanted), 0.6 * wanted, 1.6 * wanted)
