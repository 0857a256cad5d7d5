"""Computes the depths of points in a solid on the host.

`phy124.kernels.distance` computes them on the device; tests/test_depth.py compares the two modules.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]


def _inside_half_space(x: Points, vectors: Points) -> Points:
    point, normal, _ = vectors
    return (point - x) @ normal


def _inside_sphere(x: Points, vectors: Points) -> Points:
    return vectors[1, 0] - np.linalg.norm(x - vectors[0], axis=1)


def _inside_box(x: Points, vectors: Points) -> Points:
    centre, half, _ = vectors
    return (half - np.abs(x - centre)).min(axis=1)


def _inside_capsule(x: Points, vectors: Points) -> Points:
    start, end, (radius, _, _) = vectors
    axis = end - start
    along = np.clip((x - start) @ axis / (axis @ axis), 0, 1)
    return radius - np.linalg.norm(x - start - along[:, None] * axis, axis=1)


_DEPTHS: dict[str, Callable[[Points, Points], Points]] = {
    "half_space": _inside_half_space,
    "sphere": _inside_sphere,
    "box": _inside_box,
    "capsule": _inside_capsule,
}


def measure_depth(shape: str, vectors: ArrayLike, x: ArrayLike) -> Points:
    """Return the depth of points below the surface of a solid [P], m; negative outside the solid.

    For a point outside a box, the result is the depth below the plane of the farthest face.

    Args:
        shape: half_space, sphere, box or capsule.
        vectors: The three vectors that define the shape [3,3]; see `phy124.kernels.distance`.
        x: The points [P,3], m.
    """
    return _DEPTHS[shape](np.asarray(x, np.float64), np.asarray(vectors, np.float64))
