"""Solves Laplace's equation inside a silhouette; the rim is the contour alpha = 1/2."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any
from weakref import finalize

import numpy as np
import scipy
from numpy.typing import NDArray

Field = NDArray[np.float64]
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
THETA_MIN = 0.1
"""Smallest distance to the rim [pixels], which keeps the matrix well conditioned."""


class Factors:
    """Sparse LU factors of a matrix, in a thread of their own.

    SciPy frees the memory of factors only in the thread that created them.
    """

    def __init__(self, matrix: Any) -> None:
        self._pool, made = ThreadPoolExecutor(1, "factorise"), list[Any]()
        self._made = made
        # Supernodal panels wider than one column take 1.5 times as long.
        factorise = partial(scipy.sparse.linalg.splu, panel_size=1, relax=1)
        self._pool.submit(lambda: made.append(factorise(matrix, "MMD_AT_PLUS_A")))
        finalize(self, _free, self._pool, made).atexit = False

    def solve(self, values: NDArray) -> NDArray:
        """Return the solution for values [N] or [N,C]."""
        made = self._made
        return self._pool.submit(lambda: made[0].solve(values)).result()


def _free(pool: ThreadPoolExecutor, made: list[Any]) -> None:
    pool.submit(made.clear)
    pool.shutdown(wait=False)


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The Laplace operator inside a silhouette, with a rim at subpixel accuracy.

    A neighbour outside has the weight 1/theta, where theta is the pixel's distance from the rim
    (Gibou et al. 2002).
    """

    inside: NDArray[np.bool_]
    weights: Field
    """Weights 1/theta of the neighbours outside [4,H,W]; 0 for neighbours inside."""

    @classmethod
    def of(cls, alpha: Field) -> Silhouette:
        """Return the operator for an alpha [H,W] in 0..1 with a transparent border."""
        inside = alpha > 0.5
        weights = np.stack([_rim_weight(alpha, inside, shift) for shift in NEIGHBOURS])
        return cls(inside, weights)

    @cached_property
    def factors(self) -> Factors:
        """LU factors of the matrix."""
        return Factors(_laplacian(self.inside, self.weights))

    def poisson(self, source: float) -> Field:
        """Solve -Laplace(u) = source with u = 0 on the rim; return u [H,W]."""
        u = np.zeros(self.inside.shape)
        u[self.inside] = self.factors.solve(np.full(int(self.inside.sum()), source))
        return u

    @cached_property
    def distance(self) -> Field:
        """Distance of each inside pixel from the rim [H,W], pixels; 0 outside."""
        rim = np.concatenate(
            [
                np.argwhere(weight > 0) + np.outer(1 / weight[weight > 0], shift)
                for weight, shift in zip(self.weights, NEIGHBOURS, strict=True)
            ]
        )
        distance = np.zeros(self.inside.shape)
        distance[self.inside] = scipy.spatial.KDTree(rim).query(np.argwhere(self.inside))[0]
        return distance

    def sides(self) -> tuple[Field, Field]:
        """Return the columns at which the rim begins and ends: left [H] and right [H].

        In a row without object, left is greater than right.
        """
        rows, width = np.arange(len(self.inside)), self.inside.shape[1]
        first, last = self.inside.argmax(axis=1), width - 1 - self.inside[:, ::-1].argmax(axis=1)
        left, right = self.weights[1][rows, first], self.weights[0][rows, last]
        empty = ~self.inside.any(axis=1)
        first, last = np.where(empty, width, first), np.where(empty, -1, last)
        return first - 1 / np.maximum(left, 1.0), last + 1 / np.maximum(right, 1.0)

    def extend(self, u: Field) -> Field:
        """Extrapolate `u` linearly across the rim; outside, `u` is negative and decreases with
        distance.
        """
        total, count = np.zeros_like(u), np.zeros_like(u)
        for weight, (dy, dx) in zip(self.weights, NEIGHBOURS, strict=True):
            mirrored = -u * np.maximum(weight - 1, 0.02)
            total += np.roll(np.where(weight > 0, mirrored, 0), (dy, dx), (0, 1))
            count += np.roll(weight > 0, (dy, dx), (0, 1))
        ghost = count > 0
        outside = np.where(ghost, total / np.maximum(count, 1), 0)
        # Farther out, only the sign of the result and the direction of its gradient matter.
        far, nearest = nearest_of(ghost)
        return np.where(self.inside, u, outside[nearest] * (1 + far))


def nearest_of(wanted: NDArray[np.bool_]) -> tuple[Field, tuple[NDArray, NDArray]]:
    """Return the distance to the nearest True pixel, and that pixel's position."""
    distance, (y, x) = scipy.ndimage.distance_transform_edt(~wanted, return_indices=True)  # pyright: ignore
    return distance, (y, x)


def _rim_weight(alpha: Field, inside: NDArray[np.bool_], shift: tuple[int, int]) -> Field:
    dy, dx = shift
    there = np.roll(alpha, (-dy, -dx), (0, 1))
    crosses = inside & ~np.roll(inside, (-dy, -dx), (0, 1))
    theta = (alpha - 0.5) / np.where(crosses, alpha - there, 1.0)
    return np.where(crosses, 1 / np.clip(theta, THETA_MIN, 1.0), 0.0)


def _laplacian(inside: NDArray[np.bool_], weights: Field) -> scipy.sparse.csc_array:
    count = int(inside.sum())
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(count)
    diagonal = np.zeros(inside.shape)
    rows, columns = [], []
    for weight, (dy, dx) in zip(weights, NEIGHBOURS, strict=True):
        there = np.roll(number, (-dy, -dx), (0, 1))
        linked = inside & (there >= 0)
        rows.append(number[linked])
        columns.append(there[linked])
        diagonal += np.where(linked, 1.0, weight)
    i, j = np.concatenate(rows), np.concatenate(columns)
    numbers = np.arange(count)
    rows = np.concatenate([i, numbers])
    values = np.concatenate([np.full(len(i), -1.0), diagonal[inside]])
    return scipy.sparse.csc_array((values, (rows, np.concatenate([j, numbers]))), (count, count))
