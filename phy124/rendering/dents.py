"""Lights solids that keep dents, such as plasticine, so that their new shape is visible.

The light and shadow of the picture belong to the object at rest and move with the material, so a
dent would hardly be visible. Therefore, the colours are multiplied by the ratio of two lights that
are computed from the normals of the surface: the light now, and the light at rest. At rest, the
picture does not change.

Neighbours on the same side of the object are joined into patches, and planes are fitted to
neighbouring patches. The light is computed on the patches.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.rendering.matte import LAMP_LIGHT, SKY, SMOOTH, blur, locate, number

PATCH, LARGEST = 0.7, 1 / 48
"""Size of the surface patches in cells of the simulation, and their largest size as a fraction of
the solid's longest side. On coarse grids, patches without this limit would be thicker than horns
and ears.
"""
SIDE = 0.7
"""Difference between two unit normals that counts as much as a distance of one patch."""
NEAR = 12
"""Number of nearest patches that determine the plane of a patch, and the light on a Gaussian."""
FLOOR = 0.5
"""Light of the sky on a surface that faces down, relative to a surface that faces up."""
CONTRAST = 1.3
"""Exponent that increases the contrast, because light in pictures comes more from one direction
than the light of lamp and sky together.
"""
RANGE = 0.7, 1.06
"""Smallest and largest factor by which light changes the colours."""


class Dents:
    """The light on the Gaussians of one solid."""

    def __init__(self, which: NDArray[np.int64], x: NDArray, cell: float, lamp: NDArray) -> None:
        """Measure a solid at rest: n Gaussians with indices `which` [n] at positions x [n,3], m.

        `cell` is the cell size of the simulation [m], and `lamp` the unit vector to the lamp.
        """
        self.which, self._lamp = which, lamp.astype(np.float32)
        outward = _outward(x, cell)
        size = min(PATCH * cell, LARGEST * float(np.ptp(x, axis=0).max()))
        features = np.concatenate([x / size, outward / SIDE], axis=1)
        patch = _number(np.rint(features).astype(np.int64))
        count = np.bincount(patch)
        self._mean = _rows(patch, np.arange(len(x)), 1 / count[patch], (len(count), len(x)))
        centre = self._mean @ features
        count = min(NEAR, len(centre))
        _, near = scipy.spatial.KDTree(centre).query(centre, np.arange(1, count + 1))
        self._along, self._across = _slopes(near, centre, self._mean @ x, self._mean @ outward)
        self._shared = _shares(features, centre, near[patch])
        self._rest = self._lit(x)

    def illuminate(self, rgb: NDArray, x: NDArray) -> NDArray[np.float32]:
        """Return the colours [n,3] of Gaussians at x [n,3], m, whose colours at rest are `rgb`."""
        change = np.clip((self._lit(x) / self._rest) ** CONTRAST, *RANGE) - 1
        return np.minimum(rgb * (1 + self._shared @ change)[:, None], 1)

    def centres(self, x: NDArray) -> NDArray[np.float32]:
        """Return the centres of the P surface patches [P,3], m."""
        return self._mean @ x

    def normals(self, x: NDArray) -> NDArray[np.float32]:
        """Return the outward unit normals of the P patches [P,3]; 0 if the neighbours of a patch
        lie on a line.
        """
        centres = self.centres(x)
        return _unit(np.cross(self._along @ centres, self._across @ centres)).astype(np.float32)

    def _lit(self, x: NDArray) -> NDArray[np.float32]:
        normals = self.normals(x)
        sky = (1 + FLOOR + (1 - FLOOR) * normals[:, 2]) / 2
        facing = (1 + normals @ self._lamp) / 2
        return SKY.mean() * sky + LAMP_LIGHT.mean() * facing**1.2


def _outward(x: NDArray, cell: float) -> NDArray[np.float64]:
    """Return the directions in which the density of the object, with its interior, decreases."""
    _, place, size = locate(x, cell)
    flat = number(np.rint(place), size)
    filled = np.zeros(size, bool)
    filled.reshape(-1)[flat] = True
    parts, _ = scipy.ndimage.label(~filled)
    solid = blur(parts != parts[0, 0, 0], SMOOTH)
    return -_unit(np.stack([slope.reshape(-1)[flat] for slope in np.gradient(solid)], axis=1))


def _slopes(near: NDArray, features: NDArray, x: NDArray, outward: NDArray) -> tuple[Any, Any]:
    """Return two matrices that compute slopes along the surface from a value on each of P patches.

    The two directions and the outward normal of a patch are perpendicular to each other. A slope is
    a least-squares fit to the nearest patches, whose indices are `near` [P,k].
    """
    m = len(x)
    outward = _unit(outward)
    helper = np.eye(3)[np.abs(outward).argmin(axis=1)]
    along = _unit(np.cross(helper, outward))
    across = np.cross(outward, along)
    away = np.linalg.norm(features[near] - features[:, None], axis=2)
    weights = np.exp(-((away / np.maximum(away.max(axis=1, keepdims=True), 1e-9)) ** 2) * 2)
    weights /= weights.sum(axis=1, keepdims=True)
    apart = x[near] - np.einsum("mk,mkd->md", weights, x[near])[:, None]
    plane = np.einsum("mkd,mad->mka", apart, np.stack([along, across], axis=1))
    moments = np.einsum("mk,mka,mkb->mab", weights, plane, plane)
    size = np.trace(moments, axis1=1, axis2=2)[:, None, None]
    fit = weights[..., None] * plane @ np.linalg.inv(moments + (1e-3 * size + 1e-12) * np.eye(2))
    fit -= weights[..., None] * fit.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(m), near.shape[1])
    first, second = (_rows(rows, near.ravel(), fit[..., a].ravel(), (m, m)) for a in (0, 1))
    return first, second


def _shares(features: NDArray, centres: NDArray, near: NDArray) -> Any:
    """Return a matrix that interpolates values from the patches `near` [n,k] to n Gaussians."""
    n, k = near.shape
    square = np.zeros((n, k), np.float32)
    for feature, centre in zip(features.T, centres.T, strict=True):
        square += (centre.astype(np.float32)[near] - feature.astype(np.float32)[:, None]) ** 2
    weights = np.maximum(1 - square / square.max(axis=1, keepdims=True), 1e-3) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    return _rows(np.repeat(np.arange(n), k), near.ravel(), weights.ravel(), (n, len(centres)))


def _number(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    cells = cells - cells.min(axis=0)
    flat: Any = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    return np.unique(flat, return_inverse=True)[1].reshape(-1)


def _rows(rows: NDArray, columns: NDArray, values: NDArray, shape: tuple[int, int]) -> Any:
    return scipy.sparse.csr_matrix((values.astype(np.float32), (rows, columns)), shape)


def _unit(vectors: NDArray) -> NDArray:
    """Normalise vectors [n,3]; vectors of length 0 remain zero."""
    length = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))[:, None]
    return vectors / np.maximum(length, 1e-12)
