"""Describes the filled part of each voxel of a body: outward normal, centre and second moments.

A voxel that is filled in part is cut by a plane with the voxel's normal, or, in a sheet thinner
than a voxel, by two parallel planes.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.runtime.cores import cores

SHEET = 0.25
"""Length of the gradient of the filled fraction [1/voxel] below which a voxel belongs to a sheet
and has no single outward normal.
"""
THIN = 1.2
"""Thickness below which a part counts as a sheet, which has two surfaces in a voxel [voxels]."""
FULL = 0.999
"""Filled fraction of a voxel that is too large to occur in a sheet."""
SAMPLES = 6
"""Number of sample points along each axis of a voxel that is partly filled."""
HALVINGS = 12
"""Number of halvings with which the position of the surface in a voxel is found."""
ROUNDING = 1e-5
"""Bound on the error of a mean share in single precision."""
BLOCK = 500
"""Number of voxels that a thread measures at once."""
NEAR, FAR = (np.array(list(np.ndindex(*3 * (2 * n + 1,)))) - n for n in (1, 2))
"""Steps from a voxel to itself and its neighbours, 27 in all, and to the 125 voxels within two
steps."""
SLOPES = 3 / 13 * NEAR / np.maximum((NEAR**2).sum(axis=1, keepdims=True), 1)
"""Weights of the 27 voxels in the gradient. Neighbours have weights in proportion to 1 /
distance^2; at a plane parallel to a face of the voxels, the gradient has the length 1.
"""


class Voxels(NamedTuple):
    """The filled parts of the V voxels that are not empty; lengths are in voxels."""

    indices: NDArray[np.int64]
    """Indices [V,3]."""
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
    around = _gather(padded, index, NEAR)
    fraction, normal = around[:, len(NEAR) // 2].copy(), -around @ SLOPES
    length = np.linalg.norm(normal, axis=1)
    normal[length < SHEET] = 0
    normal /= np.maximum(length, SHEET)[:, None]
    shift, spread = np.zeros((len(index), 3)), np.tile(np.eye(3) / 12, (len(index), 1, 1))
    cut = np.flatnonzero(fraction < 1)
    number, across, offset = _find_sheets(
        padded, index[cut], around[cut], np.logical_not(normal[cut].any(axis=1))
    )
    normals, offsets, sheet = normal[cut], np.zeros(len(cut)), np.zeros(len(cut), bool)
    normals[number], offsets[number], sheet[number] = across, offset, True
    shift[cut], spread[cut] = _part_moments(normals, offsets, sheet, fraction[cut])
    return Voxels(index, fraction, normal, shift, spread)


def _gather(padded: NDArray, index: NDArray, steps: NDArray) -> NDArray[np.float64]:
    """Return the values at some steps from each voxel [V,S]; the grid is padded by 2 voxels."""
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    return padded.ravel()[((index + 2) @ strides)[:, None] + steps @ strides]


def _find_sheets(
    padded: NDArray, index: NDArray, around: NDArray, no_normal: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the thin sheets, and the voxels that belong to them.

    Args:
        padded: Filled fractions, padded by 2 voxels.
        index: Indices of the voxels [V,3].
        around: Filled fractions of the 27 voxels around [V,27].
        no_normal: Voxels that must be part of a sheet [V].

    Returns:
        Numbers of the K voxels [K]; normals [K,3], along which the filled parts of the surrounding
        125 voxels extend least; and distances of the sheets from the voxels' middles [K].
    """
    total = around.sum(axis=1)
    layers = np.where(around.max(axis=1) < FULL, total / 9, np.inf)
    # The thickness is `layers` times the largest component of the normal, at least 1 / sqrt(3).
    near = np.flatnonzero((layers < math.sqrt(3) * THIN) | no_normal)
    # Two layers of voxels would not tell a sheet's normal from a direction across its rim.
    weight = _gather(padded, index[near], FAR)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    middle = weight @ FAR
    second = weight @ (FAR[:, :, None] * FAR[:, None, :]).reshape(-1, 9)
    _, axes = np.linalg.eigh(second.reshape(-1, 3, 3) - middle[:, :, None] * middle[:, None, :])
    normal = axes[:, :, 0]
    thin = (layers[near] * np.abs(normal).max(axis=1) < THIN) | no_normal[near]
    near, normal = near[thin], normal[thin]
    centre = around[near] @ NEAR / np.maximum(total[near], 1e-9)[:, None]
    return near, normal, np.einsum("vi,vi->v", centre, normal)


def _part_moments(
    normal: NDArray, offset: NDArray, sheet: NDArray[np.bool_], fraction: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [V,3] and second moments [V,3,3] of the filled parts of voxels.

    The centres and moments are computed from `SAMPLES` points per axis; a point at the surface
    counts in part.

    Args:
        normal: Outward normals [V,3].
        offset: Distances of sheets from the middles of the voxels [V].
        sheet: Whether the part is a sheet between two planes [V].
        fraction: Filled fractions [V].
    """
    centre, spread = np.zeros((len(normal), 3)), np.zeros((len(normal), 3, 3))
    line = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    products = (points[:, :, None] * points[:, None, :]).reshape(-1, 9)

    def measure(some: NDArray[np.int64]) -> None:
        height, thin = normal[some] @ points.T, sheet[some]
        height[thin] = np.abs(height[thin] - offset[some][thin, None])
        width = np.abs(normal[some]).sum(axis=1)[:, None] / SAMPLES
        level = find_levels(height, width, fraction[some, None])
        share = _share_below(level, height, width)
        share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-9)
        centre[some] = share @ points
        middle = centre[some][:, :, None] * centre[some][:, None, :]
        of_sample = np.eye(3) / (12 * SAMPLES**2)
        spread[some] = (share @ products).reshape(-1, 3, 3) - middle + of_sample

    blocks = np.array_split(np.arange(len(normal)), max(1, len(normal) // BLOCK))
    with ThreadPoolExecutor(min(cores(), len(blocks)), "voxels") as pool:
        list(pool.map(measure, blocks))
    return centre, spread


def find_levels(height: NDArray, width: NDArray, fraction: NDArray) -> NDArray[np.float64]:
    """Return the levels [V,1] below which voxels are filled.

    Sums in single precision are twice as fast. Sums that are close to the fraction are repeated in
    double precision, so that the levels are those of double precision.

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
    """Return the part of each sample that is below a level [V,S]."""
    return np.clip((level - height) / width + 0.5, 0, 1)
