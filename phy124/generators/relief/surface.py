"""Defines the closed surface z^2 = w(x, y), and distributes points evenly over it.

Coordinates are pixels: x right, y down, z towards the camera. The surface has no seam, because it
is the zero set of a function.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.generators.relief.ends import End
from phy124.generators.relief.height import nearest_of
from phy124.kernels import implicit
from phy124.runtime.cores import cores

VIEW_DISTANCE = 2.0
"""Distance of the front camera, relative to the object's longest side."""


@dataclass(frozen=True)
class View:
    """The perspective of the front camera.

    Relative to the centre, x' = x k(z) and y' = y k(z), where k = 1 - z / distance.
    """

    middle: Field
    """Pixel at the centre of the view [3], with z = 0."""
    distance: float
    """Distance of the camera from the object's centre [pixels]."""

    @classmethod
    def of(cls, object_mask: NDArray[np.bool_], distance: float) -> View:
        """Return the camera that looks at the centre of the bounding box of a mask [H,W]."""
        y, x = np.nonzero(object_mask)
        return cls(np.array([x.min() + x.max(), y.min() + y.max(), 0.0]) / 2, distance)

    def k(self, z: Field) -> Field:
        """Return the scale factor of the perspective at z."""
        return 1 - z / self.distance

    def project_points(self, points: Field, normals: Field) -> tuple[Field, Field]:
        """Project points and normals [N,3]; the returned points are relative to `middle`."""
        flat, z = (points - self.middle)[:, :2], points[:, 2:]
        k = self.k(z)
        across = normals[:, :2] / k
        along = normals[:, 2:] + (flat * across).sum(axis=1, keepdims=True) / self.distance
        turned = np.concatenate([across, along], axis=1)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return np.concatenate([flat * k, z], axis=1), turned


Field = NDArray[np.float64]
Neighbours = NDArray[np.int32]
BACK_PITCH = 1.5
"""Spacing of points on the back, relative to the spacing in front. It is larger because the back's
colours are smooth.
"""
OVERHANG = 5.0
"""Points are distributed up to this distance beyond the flat ends [pixels]."""
TRIAL = 2.0
"""Spacing of the random points that measure the surface's area [pixels]."""
WIDEST = 5.0
"""Largest spacing of points that are scattered directly [pixels]. Larger cubes would miss parts of
the surface.
"""
ROUNDS = 6
"""Number of relaxation rounds; after five rounds, the spacing is even to about 10 %."""
ALIKE = 3
"""Number of rounds between two searches for neighbours. The searches are slow."""


def smooth(values: Field, weights: NDArray, width: float) -> Field:
    """Average values [H,W] with a Gaussian kernel times the weights [H,W]; the result is 0 in
    pixels whose weight is 0.
    """
    weights = weights.astype(np.float64)
    total = scipy.ndimage.gaussian_filter(values * weights, width)
    fraction = scipy.ndimage.gaussian_filter(weights, width)
    return np.where(weights > 0, total / np.maximum(fraction, 1e-9), 0.0)


def _slopes(values: Field, inside: NDArray[np.bool_]) -> tuple[Field, Field]:
    """Return the derivatives of a field, downwards and to the right, at the pixels `inside`."""
    slopes = []
    for axis in (0, 1):
        step = np.diff(values, axis=axis, append=0)
        pair = inside & np.roll(inside, -1, axis)
        step, count = np.where(pair, step, 0.0), pair.astype(int)
        total, count = step + np.roll(step, 1, axis), count + np.roll(count, 1, axis)
        slopes.append(total / np.maximum(count, 1))
    return slopes[0], slopes[1]


class Implicit(ABC):
    """The zero set of a function F that is positive inside the object."""

    kernels: ClassVar[implicit.Kernels]

    @cached_property
    @abstractmethod
    def struct(self) -> Any:
        """The fields as a Warp struct."""

    def gradient(self, points: Field) -> tuple[Field, Field]:
        """Return F [N] and the gradient [N,3] at points [N,3]."""
        values, gradients = np.empty(len(points)), np.empty(points.shape)
        launch(self.kernels.evaluate, [self.struct], [points, values, gradients])
        return values, gradients

    def normals(self, points: Field) -> Field:
        """Return outward unit normals [N,3]."""
        normals = np.empty(points.shape)
        launch(self.kernels.orient, [self.struct], [points, normals])
        return normals

    def inset(self, points: Field, depth: float) -> Field:
        """Return `depth` [N,1], limited to a third of the radius of curvature [pixels]."""
        _, gradient = self.gradient(points)
        # For a ball, F = r^2 - |x|^2, so the norm of the gradient is twice the radius.
        radius = 0.5 * np.linalg.norm(gradient, axis=1, keepdims=True)
        return np.minimum(depth, radius / 3)

    def project(self, points: Field, rounds: int = 2) -> Field:
        """Move points onto the surface by `rounds` Newton steps of at most one pixel each."""
        points = np.array(points, np.float64, order="C")
        launch(self.kernels.project, [self.struct, rounds], [points])
        return points


@dataclass(frozen=True, eq=False)
class Surface(Implicit):
    """The zero set of F(x, y, z) = w(x, y) - (z - m(x, y))^2."""

    kernels: ClassVar[implicit.Kernels] = implicit.INFLATED

    w: Field
    """Squared half thickness [H,W], pixels^2; negative outside."""
    m: Field
    """Coordinate z of the midsurface [H,W], pixels."""
    slopes: Field
    """Derivatives of w and m along x and y [2,2,H,W]."""

    @classmethod
    def of(cls, w: Field, m: Field | None = None) -> Surface:
        """Return the surface with squared half thicknesses w and a midsurface m (0 by default)."""
        m = np.zeros_like(w) if m is None else m
        slopes = [np.gradient(scipy.ndimage.gaussian_filter(field, 0.7))[::-1] for field in (w, m)]
        return cls(w, m, np.asarray(slopes))

    @classmethod
    def seen(cls, w: Field, middle: Field, distance: float) -> Surface:
        """Return the surface whose image, seen by the camera of `View`, is w.

        A camera sees less than half of a ball.

        Let p be a pixel relative to the image centre, d the distance of the camera, and w = h^2 -
        |p - c|^2 the image of a ball. Along the view ray, with A = 1 + p^2 / d^2, the ball's
        midsurface is at z = p (p - k c) / (d A), k = 1 / (1 + h^2 / d^2), and its squared half
        thickness is w k / (A B), B = 1 + p (p - c) / d^2 (exactly, if c = 0). Here p - c = -grad(w)
        / 2.
        """
        inside = w > 0
        dy, dx = (smooth(slope, inside, 1.5) for slope in _slopes(w, inside))
        y, x = np.mgrid[: len(w), : w.shape[1]]
        x, y = (x - middle[0]) / distance, (y - middle[1]) / distance
        squared, limit = x**2 + y**2, np.hypot(x, y) * np.sqrt(w.max())
        across = np.clip(-(x * dx + y * dy) / 2, -limit, limit)
        radius = np.minimum(np.maximum(w, 0) + (dx**2 + dy**2) / 4, w.max())
        k = 1 / (1 + radius / distance**2)
        m = (distance * squared * (1 - k) + k * across) / (1 + squared)
        nearest = nearest_of(inside)[1]
        scale = k / ((1 + squared) * (1 + across / distance))
        return cls.of(w * scale[nearest], smooth(m, inside, 2.0)[nearest])

    @cached_property
    def struct(self) -> Any:
        """The fields as a Warp struct."""
        struct, size = implicit.Inflated(), self.w.shape
        fields = np.stack([self.w, self.m, *self.slopes.reshape(4, *size)], axis=2)
        struct.fields = wp.array(fields, dtype=wp.float64, device="cpu")
        return struct

    def middle(self, points: Field) -> Field:
        """Return z of the midsurface at points [N,3 or 2]."""
        return scipy.ndimage.map_coordinates(self.m, points[:, 1::-1].T, order=1, mode="nearest")

    def section(self, y: float) -> float:
        """Return the area of the horizontal cross-section at row y [pixels^2]."""
        row = self.w[min(int(y), len(self.w) - 1)]
        return float(2 * np.sqrt(np.maximum(row, 0)).sum())


def pitch_factor(normals: Field) -> Field:
    """Return the relative spacing of points with normals [N,3]: 1 in front, larger behind."""
    return np.interp(-normals[:, 2], [0.0, 0.5], [1.0, BACK_PITCH])


def spread(
    surface: Surface,
    ends: Sequence[End],
    count: int,
    rng: np.random.Generator,
    alive: Callable[[], None] = lambda: None,
) -> tuple[Field, Field, Field, float]:
    """Distribute points evenly over the surface between the flat ends.

    Args:
        surface: The surface.
        ends: The flat ends of the object.
        count: Approximate number of points, including flat ends.
        rng: Random number generator.
        alive: Called between rounds; may raise an exception to cancel.

    Returns:
        Positions [N,3], unit normals [N,3], spacing [N], and the spacing on the front, pixels. A
            few points lie beyond the ends; the caller must remove them.
    """
    trial = _scatter(surface, TRIAL, rng)
    walls = TRIAL**2 * np.count_nonzero(_between(trial, ends))
    faces = sum(surface.section(end.corner) for end in ends)
    pitch = float(np.sqrt((walls + faces) / count))
    few, part = pitch > WIDEST, (TRIAL / pitch) ** 2
    points = thin_out(trial, part, rng) if few else _scatter(surface, pitch, rng)
    points = points[_between(points, ends, OVERHANG)]

    def spacing_at(normals: Field) -> Field:
        return pitch * pitch_factor(normals)

    points = settle(surface, points, spacing_at, alive)
    _, spacing = relax(surface, points, spacing_at)
    return points, surface.normals(points), spacing, pitch


def thin_out(points: Field, part: float, rng: np.random.Generator) -> Field:
    """Choose a part (a fraction) of points [N,3] at random."""
    count = max(round(len(points) * part), 1)
    return points[rng.choice(len(points), count, replace=False)]


def _between(points: Field, ends: Sequence[End], by: float = 0.0) -> NDArray[np.bool_]:
    """Return whether each point lies at most `by` pixels beyond the ends."""
    kept = np.ones(len(points), bool)
    for end in ends:
        kept &= ~end.beyond(points[:, 1], by)
    return kept


def _scatter(surface: Surface, pitch: float, rng: np.random.Generator) -> Field:
    """Return random points near the surface: on the front, on average one point per area of
    pitch^2.

    A plane with normal n intersects |nx| + |ny| + |nz| cubes per unit square. Each of these cubes
    provides one candidate, and candidates are removed at random to undo this factor.
    """
    halves = []
    for corner, low, high in _columns(surface, pitch):
        first, last = np.floor(low / pitch).astype(int), np.floor(high / pitch).astype(int)
        layers = last - first + 1
        column = np.repeat(np.arange(len(corner)), layers)
        layer = np.arange(len(column)) - np.repeat(np.cumsum(layers) - layers, layers)
        layer += first[column]
        half = np.concatenate([corner[column], layer[:, None] * pitch], axis=1)
        halves.append(half + pitch * rng.random(half.shape))
    points = surface.project(np.concatenate(halves), rounds=4)
    value, gradient = surface.gradient(points)
    slope = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
    landed = np.abs(value) < 0.5 * slope
    normals = -gradient / np.maximum(slope, 1e-12)[:, None]
    chance = 1 / (np.abs(normals).sum(axis=1) * pitch_factor(normals) ** 2)
    return points[landed & (rng.random(len(points)) < chance)]


def _columns(surface: Surface, pitch: float) -> list[tuple[Field, Field, Field]]:
    """Return the corners [M,2] and the lowest and highest z [M] of the square columns that meet the
    surface, for the front and the back.
    """
    height, width = surface.w.shape
    x, y = np.arange(0, width - 1 - pitch, pitch), np.arange(0, height - 1 - pitch, pitch)
    # Sample the fields at the corners of all squares and halfway between the corners.
    halves = [np.arange(2 * len(along) + 1) * (pitch / 2) for along in (y, x)]
    places = np.meshgrid(*halves, indexing="ij")
    w, m = (
        scipy.ndimage.map_coordinates(field, places, order=1) for field in (surface.w, surface.m)
    )
    thirds = slice(0, -2, 2), slice(1, -1, 2), slice(2, None, 2)
    around = [(rows, columns) for rows in thirds for columns in thirds]
    row, column = np.nonzero(np.maximum.reduce([w[part] for part in around]) > 0)
    corner, half = np.stack([x[column], y[row]], axis=1), np.sqrt(np.maximum(w, 0))
    sides = []
    for z in (m + half, m - half):
        near = np.stack([z[part][row, column] for part in around])
        sides.append((corner, near.min(axis=0), near.max(axis=0)))
    return sides


def settle(
    surface: Implicit,
    points: Field,
    spacing_at: Callable[[Field], Field],
    alive: Callable[[], None] = lambda: None,
) -> Field:
    """Relax points [N,3] in several rounds.

    Args:
        surface: The surface.
        points: The points to relax.
        spacing_at: Function from normals [N,3] to the desired spacing [N].
        alive: Called between rounds; may raise an exception to cancel.
    """
    for _ in range(ROUNDS // ALIKE):
        near = neighbours(points)
        for _ in range(ALIKE):
            alive()
            points, _ = relax(surface, points, spacing_at, near)
    alive()
    return points


def relax(
    surface: Implicit,
    points: Field,
    spacing_at: Callable[[Field], Field],
    near: Neighbours | None = None,
) -> tuple[Field, Field]:
    """Push points [N,3] apart along a surface; also return the mean distances to neighbours [N].

    Args:
        surface: The surface.
        points: The points.
        spacing_at: Function from normals [N,3] to the desired spacing [N].
        near: Indices of the neighbours [N,7]; None: the neighbours are searched.
    """
    near = neighbours(points) if near is None else near
    normals = surface.normals(points)
    moved, spacing = np.empty(points.shape), np.empty(len(points))
    shared = [share(points), share(normals), share(spacing_at(normals)), near]
    wp.launch(implicit.push, len(points), shared, [share(moved), share(spacing)], device="cpu")
    return surface.project(moved), spacing


def neighbours(points: Field) -> Neighbours:
    """Return the indices of the seven nearest neighbours [N,7], nearest first."""
    # these options halve the time to build the tree
    tree = scipy.spatial.KDTree(points, leafsize=16, balanced_tree=False)
    near = tree.query(points, k=min(8, len(points)), workers=-1)[1]
    return np.ascontiguousarray(np.asarray(near)[:, 1:], np.int32)


def share(values: Field) -> wp.array:
    """Wrap points [N,3] or numbers [N] as a Warp array; the memory is shared where possible."""
    dtype: Any = wp.vec3d if values.ndim == 2 else wp.float64
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu", copy=False)


def launch(kernel: Any, constants: list[Any], values: Sequence[Field]) -> None:
    """Run a kernel once per point on all cores."""
    # Several threads cannot load a kernel in Warp at the same time.
    wp.load_module(kernel.module, "cpu")
    count = cores()

    def run(part: int) -> None:
        rows = [np.array_split(array, count)[part] for array in values]
        wp.launch(kernel, len(rows[0]), [*constants, *map(share, rows)], device="cpu")

    with ThreadPoolExecutor(count) as pool:
        list(pool.map(run, range(count)))
