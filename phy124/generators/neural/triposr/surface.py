"""Extracts the surface of a density field, and covers it with Gaussians."""

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray
from warp.geometry import IsoSurfaceMarchingCubes

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.neural.triposr.field import RADIUS, Field
from phy124.generators.shapes import choose_triangles, cover_surface

THRESHOLD = 25.0
"""Density at the surface, as in the original program."""
COARSE = 64
"""Intervals per axis of the coarse grid."""
REFINE = 3
"""Number of fine intervals in each coarse interval."""
NEAR = 3.0
"""The fine grid is evaluated near points whose |log(density / threshold)| is below this value."""
FRAGMENT = 0.01
"""Pieces below this fraction of the largest piece's volume are removed."""
BATCH = 1 << 18
"""Number of points between two reports of progress."""
COUNT = 40_000
"""Approximate number of Gaussians."""
Step = Callable[[int, int], None]
"""Called with the number of finished steps and the total number of steps."""


def cover_field(
    field: Field, *, seed: int = 0, count: int = COUNT, step: Step = lambda done, total: None
) -> Gaussians:
    """Cover the surface of a density field with flat Gaussians in the field's colours.

    Args:
        field: Density and colour.
        seed: Seed of the Gaussians' positions.
        count: Approximate number of Gaussians.
        step: Called with the number of finished steps and the total number.

    Raises:
        InputError: If the field has no surface.
    """
    values = sample_grid(field, step)
    corners = extract_triangles(values)
    chosen, weights = choose_triangles(corners, count, seed)
    points = np.einsum("nc,nci->ni", weights, corners[chosen])
    _, colours = field(points)
    return cover_surface(points, _normals(values, points), colours, shaded=False)


def sample_grid(field: Field, step: Step = lambda done, total: None) -> NDArray[np.float32]:
    """Return log(density / threshold) [N,N,N], positive inside.

    Away from the surface, the values are interpolated from a coarse grid.
    """
    everywhere = np.argwhere(np.ones((COARSE + 1,) * 3, bool))
    coarse = _evaluate(field, _axis(COARSE + 1), everywhere, step).reshape((COARSE + 1,) * 3)
    near = np.abs(coarse) < NEAR
    for axis in range(3):  # cells that the surface crosses are always refined
        ahead = np.diff(coarse > 0, axis=axis)
        first, last = (
            (slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None))
        )
        near[first] |= ahead
        near[last] |= ahead
    near = scipy.ndimage.binary_dilation(near, np.ones((3, 3, 3)))
    size = REFINE * COARSE + 1
    index = np.arange(size) / REFINE
    values = _zoom(coarse, index)
    nearest = np.rint(index).astype(np.int64)
    fine = near[np.ix_(nearest, nearest, nearest)]
    places = np.argwhere(fine)
    values[tuple(places.T)] = _evaluate(field, _axis(size), places, step)
    return drop_fragments(values)


def extract_triangles(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the triangles [T,3,3] of the surface where `values` is 0.

    Raises:
        InputError: If there is no surface.
    """
    if not (values > 0).any():
        limit = "The network found no object in it."
        remedy = "Choose relief, or give a picture that shows the whole object."
        raise InputError("image", "triposr", limit, remedy)
    padded = np.pad(values, 1, constant_values=float(min(values.min(), -1.0)))
    edge = RADIUS + 2 * RADIUS / (len(values) - 1)
    with wp.ScopedDevice("cpu"):
        array: Any = wp.array(padded, dtype=wp.float32)
        vertices, indices = IsoSurfaceMarchingCubes.extract(
            array, 0.0, lower=wp.vec3(-edge, -edge, -edge), upper=wp.vec3(edge, edge, edge)
        )
    faces = indices.numpy().astype(np.int64).reshape(-1, 3)
    return vertices.numpy().astype(np.float64)[faces]


def drop_fragments(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Remove separate pieces below the fraction `FRAGMENT` of the largest volume."""
    labels, count = scipy.ndimage.label(values > 0)  # pyright: ignore
    if count > 1:
        sizes = np.bincount(labels.ravel())[1:]
        small = 1 + np.flatnonzero(sizes < FRAGMENT * sizes.max())
        values[np.isin(labels, small)] = -1.0
    return values


def _axis(size: int) -> NDArray[np.float32]:
    return np.linspace(-RADIUS, RADIUS, size, dtype=np.float32)


def _evaluate(
    field: Field, axis: NDArray, places: NDArray[np.int64], step: Step
) -> NDArray[np.float32]:
    """Return log(density / threshold) [N] at indices [N,3] of a cubic grid."""
    decode, total = field.on_grid(axis), len(places)
    parts = []
    for start in range(0, total, BATCH):
        step(start, total)
        density = np.maximum(decode(places[start : start + BATCH]), 1e-12)
        parts.append(np.log(density / THRESHOLD).astype(np.float32))
    return np.concatenate(parts) if parts else np.empty(0, np.float32)


def _zoom(values: NDArray[np.float32], index: NDArray) -> NDArray[np.float32]:
    for axis in range(3):
        low = np.minimum(index.astype(np.int64), values.shape[axis] - 2)
        part = (index - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        below, above = np.take(values, low, axis), np.take(values, low + 1, axis)
        values = (below * (1 - part) + above * part).astype(np.float32)
    return values


def _normals(values: NDArray[np.float32], points: NDArray) -> NDArray[np.float64]:
    """Return outward unit normals [N,3] at points [N,3]."""
    step = 2 * RADIUS / (len(values) - 1)
    place = (points + RADIUS) / step
    low = np.clip(place.astype(np.int64), 0, len(values) - 2)
    part = place - low
    gradient = np.zeros((len(points), 3))
    for corner in product((0, 1), repeat=3):
        value = values[tuple((low + corner).T)].astype(np.float64)
        side = np.where(corner, part, 1 - part)
        for axis in range(3):
            others = np.prod(np.delete(side, axis, axis=1), axis=1)
            gradient[:, axis] += (1 if corner[axis] else -1) * others * value
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    return -gradient / np.maximum(length, 1e-12)
