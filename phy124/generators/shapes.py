"""Makes a sphere, a box or a capsule of flat Gaussians, without an image."""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, quaternions, spread_directions
from phy124.particles.extent import limit_to_surface

COUNT = 8000
"""Approximate number of Gaussians."""
TRIES = 6
"""Number of random points on the triangles from which one evenly spaced point is chosen."""
FLATNESS = 0.15
"""Thickness of Gaussians, relative to their width."""
LIGHT = (0.35, 0.25, 0.9)
"""Direction towards the light."""
AMBIENT = 0.72
"""Brightness of surfaces whose normal is perpendicular to the light."""
CHECKS = 8
"""Number of checker squares along the longest side."""
CONTRAST = 0.05
Surface = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Points [N,3] and outward unit normals [N,3]."""


def make_shape(
    name: str,
    sides: Sequence[float],
    colour: Sequence[float],
    *,
    patterned: bool = True,
    count: int | None = None,
) -> Gaussians:
    """Make the Gaussians of a simple shape, centred on the origin.

    Args:
        name: sphere (an ellipsoid if the sides differ), box, or capsule (along its longest side).
        sides: Lengths of the shape along x, y and z, m.
        colour: Red, green and blue, 0..1.
        patterned: Whether a checker pattern and a light make the motion visible.
        count: Approximate number of Gaussians; None: `COUNT`.
    """
    half = np.asarray(sides, np.float64) / 2
    x, normals = {"sphere": _sphere, "box": _box, "capsule": _capsule}[name](half, count or COUNT)
    squares = np.floor(CHECKS * x / (2 * half.max()) + 0.25).sum(axis=1) % 2
    width = 0.75 * float(np.sqrt(_area(half) / len(x)))
    bright = 1 - CONTRAST * squares if patterned else 1.0
    rgb = np.asarray(colour)
    return cover_surface(x, normals, rgb, width=width, bright=bright, shaded=patterned)


def cover_surface(
    points: NDArray,
    normals: NDArray,
    rgb: NDArray,
    *,
    width: float | None = None,
    bright: NDArray | float = 1.0,
    shaded: bool = True,
) -> Gaussians:
    """Cover a surface with flat Gaussians that do not extend beyond its ends.

    Args:
        points: Centres [N,3], m.
        normals: Outward unit normals [N,3].
        rgb: Colours [N,3], or a single colour for all points [3], 0..1.
        width: Standard deviation along the surface [m]; None: from the spacing of the points.
        bright: Factors of the colours [N].
        shaded: Whether a light from above shades the surface.
    """
    wide = _spread(points, normals) if width is None else np.full(len(points), width)
    scales = np.stack([wide, wide, FLATNESS * wide], axis=1)
    facing = (normals @ LIGHT / np.linalg.norm(LIGHT)).clip(-1, 1)
    lit = AMBIENT + (1 - AMBIENT) * facing if shaded else np.ones(len(points))
    colours, opacities = ((lit * bright)[:, None] * rgb).clip(0, 1), np.full(len(points), 0.95)
    made = Gaussians.from_rgb(points, _facing(normals), scales, opacities, colours)
    return limit_to_surface(made)


def choose_triangles(
    corners: NDArray, count: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Choose about `count` evenly spaced points on a set of triangles.

    Args:
        corners: Corners of the triangles [T,3,3].
        count: Approximate number of points.
        seed: Seed of the points' positions.

    Returns:
        The index of each point's triangle [N], and the point's barycentric coordinates [N,3].
    """
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = np.linalg.norm(normals, axis=1) / 2
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(areas), TRIES * count, p=areas / areas.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), len(chosen))
    points = np.einsum("nc,nci->ni", weights, corners[chosen])
    kept = _thin(points, normals[chosen], np.sqrt(areas.sum() / count))
    return chosen[kept], weights[kept]


def _thin(points: NDArray, normals: NDArray, width: float) -> NDArray[np.int64]:
    """Return the index of one point for each cube of a grid, without empty cubes. A cube that
    contains both sides of a thin sheet gets a second point.
    """
    _, cube = np.unique(np.floor(points / width)[:, ::-1], axis=0, return_inverse=True)
    cube = cube.ravel()
    first = _nearest_to_middle(points, cube, width)
    is_behind = (normals * normals[first][cube]).sum(axis=1) < 0
    behind = np.flatnonzero(is_behind)
    _, cube = np.unique(cube[behind], return_inverse=True)
    second = behind[_nearest_to_middle(points[behind], cube, width)]
    return np.concatenate([first, second])


def _nearest_to_middle(points: NDArray, cube: NDArray, width: float) -> NDArray[np.int64]:
    """Return the index of the point nearest to the middle of each cube, in the order of `cube`."""
    off = np.linalg.norm(points / width - np.floor(points / width) - 0.5, axis=1)
    order = np.lexsort((off, cube))
    is_first = np.diff(cube[order], prepend=-1) != 0
    return order[is_first]


def _spread(points: NDArray, normals: NDArray) -> NDArray[np.float64]:
    """Return 0.75 times the mean distance [m] from each point to its six nearest neighbours [N],
    without points on the opposite side of a thin sheet.
    """
    near, index = scipy.spatial.KDTree(points).query(points, k=min(13, len(points)))
    other = (normals[index] * normals[:, None]).sum(axis=2) < -0.5
    distance = np.sort(np.where(other, np.inf, near), axis=1)[:, 1:7]
    count = np.isfinite(distance).sum(axis=1)
    mean = np.where(np.isfinite(distance), distance, 0).sum(axis=1) / np.maximum(count, 1)
    return 0.75 * np.maximum(mean, 1e-9)


def _area(half: NDArray) -> float:
    """Return the surface area [m^2] of a box with the half side lengths `half`, an upper bound for
    the other shapes.
    """
    a, b, c = 2 * half
    return float(2 * (a * b + b * c + c * a))


def _sphere(half: NDArray, count: int) -> Surface:
    directions = spread_directions(count)
    normals = directions / half
    return directions * half, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _box(half: NDArray, count: int) -> Surface:
    step = np.sqrt(_area(half) / count)
    points, normals = [], []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        steps = [max(2, round(2 * half[i] / step)) for i in others]
        grid = [
            ((np.arange(n) + 0.5) / n * 2 - 1) * half[i] for n, i in zip(steps, others, strict=True)
        ]
        u, v = map(np.ravel, np.meshgrid(*grid, indexing="ij"))
        for side in (-1.0, 1.0):
            face, outward = np.empty((len(u), 3)), np.zeros((len(u), 3))
            face[:, others[0]], face[:, others[1]], face[:, axis] = u, v, side * half[axis]
            outward[:, axis] = side
            points.append(face)
            normals.append(outward)
    return np.concatenate(points), np.concatenate(normals)


def _capsule(half: NDArray, count: int) -> Surface:
    """Distribute points evenly over a cylinder with a hemisphere at each end."""
    axis = int(np.argmax(half))
    across = np.delete(half, axis)
    radius, length = float(across.max()), float(half[axis] - across.max())
    # Archimedes' theorem: between two heights, a sphere has the same area as its circumscribed
    # cylinder.
    height = (np.arange(count) + 0.5) / count * 2 - 1
    along = height * (length + radius)
    middle = along.clip(-length, length)
    out = (along - middle) / radius
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - out**2)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), out], axis=1)
    points = radius * normals
    points[:, 2] += middle
    order = np.argsort([(axis + 1) % 3, (axis + 2) % 3, axis])
    flat = np.ones(3)
    flat[[i for i in range(3) if i != axis]] = across / radius
    outward = normals[:, order] / flat
    return points[:, order] * flat, outward / np.linalg.norm(outward, axis=1, keepdims=True)


def _facing(normals: NDArray) -> NDArray[np.float64]:
    """Return quaternions [N,4] that rotate the third axes of discs to the normals."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.7, [[0.0, 0, 1]], [[1.0, 0, 0]])
    along = np.cross(helper, normals)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return quaternions(np.stack([along, np.cross(normals, along), normals], axis=2))


def ball(count: int = 6000, diameter: float = 1.0) -> Gaussians:
    """Return a ball of flat Gaussians that faces +x."""
    normals = spread_directions(count)
    helper = np.where(np.abs(normals[:, 2:]) < 0.7, [[0.0, 0, 1]], [[1.0, 0, 0]])
    along = np.cross(helper, normals)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along), normals], axis=2)
    width = 0.7 * diameter / 2 * np.sqrt(4 * np.pi / count)
    longitude = np.arctan2(normals[:, 1], normals[:, 0])
    squares = np.floor(longitude * 4 / np.pi) + np.floor(4 * normals[:, 2])
    rgb = np.where((squares % 2 == 0)[:, None], [[0.85, 0.2, 0.15]], [[0.95, 0.9, 0.8]])
    return Gaussians.from_rgb(
        (normals * diameter / 2).astype(np.float32),
        quaternions(axes).astype(np.float32),
        np.tile(np.array([width, width, FLATNESS * width], np.float32), (count, 1)),
        np.full(count, 0.95, np.float32),
        rgb.astype(np.float32),
    )
