"""Computes outward normal, centre and second moments of the filled part of each voxel of a body.

A partly filled voxel is cut by a plane with the voxel's normal. In a sheet that is thinner than a
voxel, the voxel is cut by two parallel planes. In a rod without full voxels, it is cut by a
cylinder.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.runtime.cores import cores

SHEET = 0.25
"""If the gradient of the filled fraction is shorter [1/voxel], a voxel belongs to a sheet and has
no single outward normal.
"""
THIN = 1.2
"""A thinner part [voxels] counts as a sheet, which has two surfaces in a voxel."""
FULL = 0.999
"""A voxel with at least this filled fraction cannot belong to a sheet or a rod."""
ROUND, WIDE, LONG = 3.5, 0.45, 2.5
"""`ROUND`: largest cross-section of a rod [voxels^2]. `WIDE`: largest second moment, perpendicular
to the rod, of the filled fractions of the surrounding 125 voxels [voxels^2]. `LONG`: smallest ratio
of the second moment along the rod to the second moment perpendicular to it.
"""
SINGLE = math.pi / 4
"""Cross-section of the thickest rod that lies in two neighbouring columns of voxels [voxels^2]."""
SAMPLES, FINER = 6, 10
"""Number of sample points along each axis of a partly filled voxel: in general, and in rods."""
HALVINGS = 12
"""Number of bisection steps for the position of the surface in a voxel."""
ROUNDING = 1e-5
"""Upper bound of the error of a mean filled fraction in single precision."""
BLOCK = 500
"""Number of voxels that a thread processes at a time."""
NEAR, FAR = (np.array(list(np.ndindex(*3 * (2 * n + 1,)))) - n for n in (1, 2))
"""Steps from a voxel to itself and its neighbours, 27 in all, and to the 125 voxels within two
steps."""
SLOPES = 3 / 13 * NEAR / np.maximum((NEAR**2).sum(axis=1, keepdims=True), 1)
"""Weights of the 27 voxels in the gradient. Neighbours have weights in proportion to 1 /
distance^2; at a plane parallel to a face of the voxels, the gradient has the length 1.
"""


class Voxels(NamedTuple):
    """The filled parts of the V voxels that are not empty; the unit of length is a voxel."""

    indices: NDArray[np.int64]
    """Indices of the voxels [V,3]."""
    fraction: NDArray[np.float64]
    """Filled fractions [V]."""
    normal: NDArray[np.float64]
    """Outward normals [V,3]; zero in sheets, which have no single outward side."""
    shift: NDArray[np.float64]
    """Centres of the filled parts, relative to the middles of the voxels [V,3]."""
    spread: NDArray[np.float64]
    """Second moments of the filled parts about their centres, per volume [V,3,3]."""


def find_voxels(filled: NDArray) -> Voxels:
    """Return the filled parts of the voxels of a grid.

    Args:
        filled: Filled fraction of each voxel [X,Y,Z].
    """
    padded = np.pad(filled.astype(np.float64), len(FAR[0]) - 1)
    index = np.argwhere(filled > 0)
    fraction, normal = _gather(padded, index, np.zeros((1, 3), int))[:, 0], np.zeros(index.shape)
    # The gradient is zero among full voxels.
    within = scipy.ndimage.minimum_filter(filled, 3, mode="constant")[tuple(index.T)] >= 1
    outer = np.flatnonzero(~within)
    around = _gather(padded, index[outer], NEAR)
    normal[outer] = -around @ SLOPES
    length = np.linalg.norm(normal, axis=1)
    normal[length < SHEET] = 0
    normal /= np.maximum(length, SHEET)[:, None]
    shift, spread = np.zeros((len(index), 3)), np.tile(np.eye(3) / 12, (len(index), 1, 1))
    part = fraction[outer] < 1
    cut, around = outer[part], around[part]
    parts = _Parts(padded, index[cut], around, np.logical_not(normal[cut].any(axis=1)))
    number, across, offset = _find_sheets(parts)
    normals, offsets, sheet = normal[cut], np.zeros(len(cut)), np.zeros(len(cut), bool)
    normals[number], offsets[number], sheet[number] = across, offset, True

    def from_planes(some: NDArray[np.int64], points: NDArray) -> tuple[NDArray, NDArray]:
        height, thin = normals[some] @ points.T, sheet[some]
        height[thin] = np.abs(height[thin] - offsets[some][thin, None])
        return height, np.abs(normals[some]).sum(axis=1)[:, None]

    shift[cut], spread[cut] = _part_moments(from_planes, fraction[cut], SAMPLES)
    number, axis, middle = _find_rods(parts)

    def from_axes(some: NDArray[np.int64], points: NDArray) -> tuple[NDArray, NDArray]:
        arm = points - middle[some][:, None]
        along = np.einsum("vsi,vi->vs", arm, axis[some])
        square = (arm**2).sum(axis=2) - along**2
        return np.sqrt(np.maximum(square, 0)), np.ones((len(some), 1))

    rods = cut[number]
    shift[rods], spread[rods] = _part_moments(from_axes, fraction[rods], FINER)
    return Voxels(index, fraction, normal, shift, spread)


def _gather(padded: NDArray, index: NDArray, steps: NDArray) -> NDArray[np.float64]:
    """Return the values at some steps from each voxel [V,S]; the grid is padded by 2 voxels."""
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    return padded.ravel()[((index + 2) @ strides)[:, None] + steps @ strides]


class _Parts:
    """Partly filled voxels that may belong to sheets or rods, with moments of what is around them.

    Args:
        padded: Filled fractions, padded by 2 voxels.
        index: Indices of the voxels [V,3].
        around: Filled fractions of the 27 voxels around each voxel [V,27].
        no_normal: Mask of voxels that must be part of a sheet [V].
    """

    def __init__(
        self, padded: NDArray, index: NDArray, around: NDArray, no_normal: NDArray
    ) -> None:
        total = around.sum(axis=1)
        layers = np.where(around.max(axis=1) < FULL, total / 9, np.inf)
        # The thickness of a sheet is `layers` times the largest component of the normal, at least
        # 1 / sqrt(3). A rod crosses three layers of voxels, or more if it is slanted.
        most = max(math.sqrt(3) * THIN, math.sqrt(3) * ROUND / 3)
        self.number = np.flatnonzero((layers < most) | no_normal)
        """Numbers of the K voxels among the V voxels [K]."""
        self.around, self.total = around[self.number], total[self.number]
        self.layers, self.no_normal = layers[self.number], no_normal[self.number]
        # With only two layers of voxels, a sheet's normal could not be distinguished from a
        # direction across the sheet's rim.
        weight = _gather(padded, index[self.number], FAR)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
        self.middle = weight @ FAR
        """Centres of the filled parts of the surrounding 125 voxels [K,3]."""
        second = (weight @ (FAR[:, :, None] * FAR[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        second -= self.middle[:, :, None] * self.middle[:, None, :]
        self.moment, self.axes = np.linalg.eigh(second)
        """Second moments of these parts, in ascending order [K,3], and their axes [K,3,3]."""


def _find_sheets(
    parts: _Parts,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the voxels that belong to thin sheets.

    Returns:
        Numbers of the K voxels [K]; normals [K,3], along which the filled parts of the surrounding
        125 voxels are thinnest; and distances of the sheets from the voxels' middles [K].
    """
    normal = parts.axes[:, :, 0]
    thin = (parts.layers * np.abs(normal).max(axis=1) < THIN) | parts.no_normal
    normal, around = normal[thin], parts.around[thin]
    centre = around @ NEAR / np.maximum(parts.total[thin], 1e-9)[:, None]
    return parts.number[thin], normal, np.einsum("vi,vi->v", centre, normal)


def _find_rods(
    parts: _Parts,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the voxels of rods, such as stems, that are too thin to have full voxels.

    Returns:
        Numbers of the K voxels [K]; directions of the rods [K,3]; and positions on the rods' axes,
        relative to the voxels' middles [K,3].
    """
    moment, axis = parts.moment, parts.axes[:, :, 2]
    area = 3 * parts.layers * np.abs(axis).max(axis=1)
    narrow = (moment[:, 1] < WIDE) & (moment[:, 2] > LONG * moment[:, 1]) & (area < ROUND)
    strip = (area > SINGLE) & (moment[:, 1] > 0.1) & (moment[:, 0] < 0.03)
    chosen = narrow & ~strip & (moment[:, 2] > WIDE)
    return parts.number[chosen], axis[chosen], parts.middle[chosen]


def _part_moments(
    measure: Callable[[NDArray[np.int64], NDArray], tuple[NDArray, NDArray]],
    fraction: NDArray,
    samples: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [V,3] and second moments [V,3,3] of the filled parts of voxels.

    A sample point at the surface counts as a fraction.

    Args:
        measure: Function that returns, for the numbers of K voxels, heights of points [S,3] in each
            voxel [K,S], and the extent of each voxel across the surface [K,1]. A voxel is filled
            below a certain height.
        fraction: Filled fractions [V].
        samples: Number of sample points along each axis.
    """
    centre, spread = np.zeros((len(fraction), 3)), np.zeros((len(fraction), 3, 3))
    line = (np.arange(samples) + 0.5) / samples - 0.5
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    products = (points[:, :, None] * points[:, None, :]).reshape(-1, 9)

    def fill(some: NDArray[np.int64]) -> None:
        height, width = measure(some, points)
        width = width / samples
        level = find_levels(height, width, fraction[some, None])
        share = _share_below(level, height, width)
        share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-9)
        centre[some] = share @ points
        middle = centre[some][:, :, None] * centre[some][:, None, :]
        of_sample = np.eye(3) / (12 * samples**2)
        spread[some] = (share @ products).reshape(-1, 3, 3) - middle + of_sample

    blocks = np.array_split(np.arange(len(fraction)), max(1, len(fraction) // BLOCK))
    with ThreadPoolExecutor(min(cores(), len(blocks)), "voxels") as pool:
        list(pool.map(fill, blocks))
    return centre, spread


def find_levels(height: NDArray, width: NDArray, fraction: NDArray) -> NDArray[np.float64]:
    """Return the heights (levels) [V,1] below which voxels are filled.

    Sums in single precision are twice as fast. Sums close to the fraction are repeated in double
    precision, so that the levels are as accurate as in double precision.

    Args:
        height: Heights of the sample points [V,S].
        width: Extent of a sample across the surface [V,1].
        fraction: Filled fractions [V,1].
    """
    rough = (height / width).astype(np.float32)
    low, high = (end(axis=1, keepdims=True) for end in (height.min, height.max))
    low, high, level = low - width, high + width, low
    for _ in range(HALVINGS):
        level = (low + high) / 2
        share = (level / width + 0.5).astype(np.float32) - rough
        total = np.clip(share, 0, 1, out=share).mean(axis=1, keepdims=True)
        more, close = total < fraction, (np.abs(total - fraction) < ROUNDING)[:, 0]
        exact = _share_below(level[close], height[close], width[close])
        more[close] = exact.mean(axis=1, keepdims=True) < fraction[close]
        low, high = np.where(more, level, low), np.where(more, high, level)
    return level


def _share_below(level: NDArray, height: NDArray, width: NDArray) -> NDArray[np.float64]:
    """Return the fraction of each sample below a level [V,S]."""
    return np.clip((level - height) / width + 0.5, 0, 1)
