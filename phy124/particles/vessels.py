"""Distinguishes walls of open vessels from shells around solid objects.

A wall, such as that of a cup, has Gaussians on both sides. A shell has one layer of Gaussians with
some noise. The heights of neighbours along a normal, relative to a fitted paraboloid, therefore
form two clusters at a wall, but a single cluster at a shell. The normal of a Gaussian that is not
flat is fitted to its neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[Any]

COUNTS = (32, 128, 512)
"""Numbers of neighbours that are examined; thick walls need many neighbours."""
PATCH = 0.125
"""Largest fraction of all Gaussians that are examined together; more would lie on opposite sides of
the object.
"""
PARALLEL = 0.8
"""Smallest cosine of the angle between the normals of neighbours."""
APART = 5.0
"""Smallest distance between the means of two clusters, relative to the standard deviation in a
cluster. A single cluster has a value of 2.7 (normal distribution) or 3.5 (uniform distribution).
"""
SMALLEST = 0.15
"""Smallest fraction of the neighbours in a cluster."""
MOST = 200_000
"""Largest number of Gaussians among which neighbours are searched."""
CHOSEN = 1000
"""Largest number of Gaussians whose neighbours are examined."""


def is_vessel(means: Array, normals: Array, near: Array) -> bool:
    """Return whether most of the Gaussians `near` belong to the wall of a vessel.

    Args:
        means: Centres of all Gaussians [N,3].
        normals: Shortest axes of all Gaussians [N,3]; zero for Gaussians that are not flat.
        near: Indices of the Gaussians in question [M].
    """
    step = -(-len(means) // MOST)
    places, axes = means[::step].astype(np.float64), normals[::step]
    chosen = near[:: -(-len(near) // CHOSEN)]
    count = min(COUNTS[-1], len(places))
    distance, neighbours = scipy.spatial.KDTree(places).query(means[chosen], count)
    arms = places[neighbours] - means[chosen][:, None]
    around, squares = axes[neighbours], (arms**2).sum(axis=2)
    is_flat = np.asarray(around.any(axis=2))
    two_sided = np.zeros(len(chosen), bool)
    for k in [k for k in COUNTS if k <= max(PATCH * len(places), COUNTS[0])]:
        normal = _find_normals(arms[:, :k], normals[chosen])
        cosine = np.abs(np.einsum("mki,mi->mk", around[:, :k], normal))
        aside = squares[:, :k] - np.einsum("mki,mi->mk", arms[:, :k], normal) ** 2
        # In a cylinder, both sides of a wall have equally many Gaussians.
        fits = (cosine > PARALLEL) | ~is_flat[:, :k]
        fits &= aside < distance[:, :k][:, -1:] ** 2 / 2
        heights = _heights_above_paraboloid(arms[:, :k], normal, fits)
        two_sided |= _have_two_clusters(heights, fits)
    return float(two_sided.mean()) > 0.5


def _find_normals(arms: Array, normals: Array) -> Array:
    """Return the normals [M,3]; instead of a zero vector, return the direction in which the
    neighbours [M,K,3] vary least.
    """
    centred = arms - arms.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", centred, centred))
    result: Array = np.where(np.asarray(normals.any(axis=1))[:, None], normals, axes[:, :, 0])
    return result


def _heights_above_paraboloid(arms: Array, normal: Array, fits: NDArray[np.bool_]) -> Array:
    """Return the heights [M,K] of points [M,K,3] along normals [M,3], above paraboloids that are
    fitted to the points for which `fits` [M,K] is true.
    """
    helper = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, helper)
    u, v, height = (
        np.einsum("mki,mi->mk", arms, axis) for axis in (first, np.cross(normal, first), normal)
    )
    size = np.sqrt((u**2 + v**2).mean(axis=1, keepdims=True)) + 1e-30
    u, v = u / size, v / size
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    weighted = terms * fits[:, :, None]
    matrix = np.einsum("mki,mkj->mij", weighted, terms) + 1e-6 * np.eye(6)
    sums = np.einsum("mki,mk->mi", weighted, height)
    fitted = np.linalg.solve(matrix, sums[:, :, None])
    result: Array = height - (terms @ fitted)[:, :, 0]
    return result


def _have_two_clusters(heights: Array, fits: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return for each row of heights [M,K] whether the heights for which `fits` [M,K] is true form
    two clusters.

    Each height of a row is tried as the threshold between the clusters (Otsu 1979).
    """
    order = np.argsort(np.where(fits, heights, np.inf), axis=1)
    weight = np.take_along_axis(fits, order, axis=1).astype(np.float64)
    value = np.take_along_axis(heights, order, axis=1) * weight
    count, total, squares = (a.sum(axis=1, keepdims=True) for a in (weight, value, value**2))
    below, sums = (np.cumsum(a, axis=1)[:, :-1] for a in (weight, value))
    above, rest = count - below, total - sums
    apart = rest / np.maximum(above, 1) - sums / np.maximum(below, 1)
    variance = squares - sums**2 / np.maximum(below, 1) - rest**2 / np.maximum(above, 1)
    is_clear = apart > APART * np.sqrt(np.maximum(variance, 0) / np.maximum(count, 1))
    is_large = np.minimum(below, above) >= np.maximum(SMALLEST * count, 2)
    result: NDArray[np.bool_] = (is_clear & is_large).any(axis=1)
    return result
