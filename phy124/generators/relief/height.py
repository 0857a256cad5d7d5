"""Inflation: how thick the object is behind each pixel of its silhouette.

The half thickness h follows from h^2 = u, -Laplace(u) = 4 within the silhouette, u = 0 on its rim
(a disc becomes a ball). It is then corrected to the thickness of the largest balls that fit inside,
so that a stalk is as deep as it is wide and does not swell. Working with h^2 keeps everything
smooth: it crosses zero at a constant slope, where h itself is infinitely steep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage as ndi
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from numpy.typing import NDArray

Field = NDArray[np.float64]
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
THETA_MIN = 0.1
"""Smallest rim distance used, pixels; keeps the matrix well conditioned."""
DEPTH = 0.9
"""Ratio of thickness to width of a small round part."""
FLATTEN = 0.42
"""Half thickness, in picture sizes, from which parts become flatter."""
SMOOTHING = 0.02
"""Width over which the correction is smoothed, in picture sizes."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A Laplace operator on the pixels inside, whose rim is located within pixels by the alpha.

    The rim is where alpha is one half. A neighbour outside at rim distance theta has weight
    1/theta, the symmetric second-order scheme of Gibou et al. 2002.
    """

    inside: NDArray[np.bool_]
    """Pixels whose centre is inside [H,W]."""
    weights: Field
    """Weight 1/theta of the rim towards each neighbour [4,H,W]; 0 where that one is inside."""
    factors: spl.SuperLU

    @classmethod
    def of(cls, alpha: Field) -> Silhouette:
        """From alpha [H,W] in 0..1 whose outermost pixels are transparent."""
        inside = alpha > 0.5
        weights = np.stack([_rim_weight(alpha, inside, shift) for shift in NEIGHBOURS])
        return cls(inside, weights, spl.splu(_laplacian(inside, weights), "MMD_AT_PLUS_A"))

    def poisson(self, source: float) -> Field:
        """Solve -Laplace(u) = source with u = 0 on the rim; [H,W], 0 outside."""
        u = np.zeros(self.inside.shape)
        u[self.inside] = self.factors.solve(np.full(int(self.inside.sum()), source))
        return u

    def harmonic(self, values: Field) -> Field:
        """Continue `values` [H,W,C] of the pixels around the rim smoothly into the inside."""
        known = np.zeros_like(values)
        for weight, (dy, dx) in zip(self.weights, NEIGHBOURS, strict=True):
            known += weight[..., None] * np.roll(values, (-dy, -dx), (0, 1))
        filled = np.array(values)
        filled[self.inside] = self.factors.solve(np.ascontiguousarray(known[self.inside]))
        return filled

    def extended(self, u: Field) -> Field:
        """`u` continued linearly across the rim: negative outside, lower farther out."""
        total, count = np.zeros_like(u), np.zeros_like(u)
        for weight, (dy, dx) in zip(self.weights, NEIGHBOURS, strict=True):
            mirrored = -u * np.maximum(weight - 1, 0.02)
            total += np.roll(np.where(weight > 0, mirrored, 0), (dy, dx), (0, 1))
            count += np.roll(weight > 0, (dy, dx), (0, 1))
        ghost = count > 0
        outside = np.where(ghost, total / np.maximum(count, 1), 0)
        # Further out only the sign and the way back matter.
        far, nearest = nearest_of(ghost)
        return np.where(self.inside, u, outside[nearest] * (1 + far))


def squared_half_thickness(silhouette: Silhouette, size: int) -> Field:
    """h^2 [H,W], pixels^2, negative outside; the object is `size` pixels large."""
    u = silhouette.poisson(4.0)
    ratio = np.clip(_balls(silhouette.inside) / np.maximum(u, 1e-9), 0.3, 1.2)
    round_ = u * _smooth_within(ratio, silhouette.inside, max(1.0, SMOOTHING * size))
    return silhouette.extended(DEPTH**2 * round_ / (1 + round_ / (FLATTEN * size) ** 2))


def nearest_of(wanted: NDArray[np.bool_]) -> tuple[Field, tuple[NDArray, NDArray]]:
    """Distance from each pixel to the nearest wanted one, pixels, and where that one is."""
    distance, (y, x) = ndi.distance_transform_edt(~wanted, return_indices=True)  # pyright: ignore
    return distance, (y, x)


def _balls(inside: NDArray[np.bool_]) -> Field:
    """Squared half thickness of the union of all balls that fit behind the silhouette.

    It is the maximum over centres m of D(m)^2 - |x - m|^2, with D the distance to the rim: a
    separable upper envelope of parabolas.
    """
    # From the pixel's centre to the rim between it and the next pixel outside.
    squares = np.where(inside, (nearest_of(~inside)[0] - 0.5) ** 2, 0.0)
    for _ in range(2):
        offsets = np.arange(squares.shape[1])
        parabolas = (offsets[:, None] - offsets).astype(np.float64) ** 2
        squares = np.stack([(row - parabolas).max(axis=1) for row in squares]).T
    return np.where(inside, squares, 0.0)


def _smooth_within(values: Field, inside: NDArray[np.bool_], width: float) -> Field:
    """Gaussian smoothing restricted to the pixels inside."""
    fraction = ndi.gaussian_filter(inside.astype(np.float64), width)
    smooth = ndi.gaussian_filter(np.where(inside, values, 0.0), width)
    return np.where(inside, smooth / np.maximum(fraction, 1e-9), 0.0)


def _rim_weight(alpha: Field, inside: NDArray[np.bool_], shift: tuple[int, int]) -> Field:
    dy, dx = shift
    there = np.roll(alpha, (-dy, -dx), (0, 1))
    crosses = inside & ~np.roll(inside, (-dy, -dx), (0, 1))
    theta = (alpha - 0.5) / np.where(crosses, alpha - there, 1.0)
    return np.where(crosses, 1 / np.clip(theta, THETA_MIN, 1.0), 0.0)


def _laplacian(inside: NDArray[np.bool_], weights: Field) -> sp.csc_array:
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
    return sp.csc_array((values, (rows, np.concatenate([j, numbers]))), (count, count))
