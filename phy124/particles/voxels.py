"""Computes for each voxel of a body its normal, and the centre and second moments of the filled
part.

A partly filled voxel is cut by a plane with the voxel's normal. In a sheet that is thinner than a
voxel, the voxel is cut by two parallel planes, and at the rim of the sheet by a third plane across
them. In a rod without full voxels, the voxel is cut by a cylinder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.voxels import AT_ONCE, fill_voxels
from phy124.runtime.compiling import compile_missing

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
SHORTEST = 0.1
"""A voxel at the rim of a sheet is filled over at least this fraction of its length across the rim.
"""
ROUNDS, FASTER, NEARLY = 3, 1.5, 0.02
"""Sheets are filled up to `ROUNDS` times, each time about a better middle. Corrections of the
middle are multiplied by `FASTER`, because they converge slowly. A voxel is not filled again if its
correction changes by less than `NEARLY` [voxels].
"""
SINGLE = math.pi / 4
"""Cross-section of the thickest rod that lies in two neighbouring columns of voxels [voxels^2]."""
SAMPLES, FINER = 6, 10
"""Number of sample points along each axis of a partly filled voxel: in general, and in rods."""
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
    filled = filled.astype(np.float64)
    padded, index = np.pad(filled, 2), np.argwhere(filled > 0)
    fraction, normal = filled[tuple(index.T)], np.zeros(index.shape)
    # The gradient is zero among full voxels.
    within = scipy.ndimage.minimum_filter(filled, 3, mode="constant")[tuple(index.T)] >= 1
    outer = np.flatnonzero(~within)
    around = _within(padded, index[outer], 1)
    normal[outer] = -around @ SLOPES
    length = np.linalg.norm(normal, axis=1)
    normal[length < SHEET] = 0
    normal /= np.maximum(length, SHEET)[:, None]
    shift, spread = np.zeros((len(index), 3)), np.tile(np.eye(3) / 12, (len(index), 1, 1))
    part = fraction[outer] < 1
    cut, around = outer[part], around[part]
    parts = _Parts(padded, index[cut], around, np.logical_not(normal[cut].any(axis=1)))
    number, sheets = _find_sheets(parts)
    single = np.delete(cut, number)
    planes = _Surfaces(np.zeros((len(single), 3)), normal[single], np.zeros(len(single), bool))
    shift[single], spread[single] = _part_moments(fraction[single], planes, SAMPLES)
    _fill_sheets(padded, index, cut[number], sheets, shift, spread)
    number, axis, middle = _find_rods(parts)
    rods, surfaces = cut[number], _Surfaces(middle, axis, np.zeros(len(number), bool), rods=True)
    shift[rods], spread[rods] = _part_moments(fraction[rods], surfaces, FINER)
    return Voxels(index, fraction, normal, shift, spread)


def _within(padded: NDArray, index: NDArray, steps: int) -> NDArray[np.float64]:
    """Return the values of a grid at the neighbours `NEAR` (one step) or `FAR` (two steps) of each
    voxel [V,S].

    The grid is padded by two voxels.
    """
    side = 2 * steps + 1
    cubes = np.lib.stride_tricks.sliding_window_view(padded, (side, side, side))
    return cubes[tuple((index + 2 - steps).T)].reshape(len(index), side**3)


class _Parts:
    """Partly filled voxels that may belong to sheets or rods, with moments of their surroundings.

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
        weight = _within(padded, index[self.number], 2)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
        self.middle = weight @ FAR
        """Centres of the filled parts of the surrounding 125 voxels [K,3]."""
        second = (weight @ (FAR[:, :, None] * FAR[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        second -= self.middle[:, :, None] * self.middle[:, None, :]
        self.moment, self.axes = np.linalg.eigh(second)
        """Second moments of these parts, in ascending order [K,3], and their axes [K,3,3]."""


class _Sheets(NamedTuple):
    """Parts of sheets in K voxels; positions are relative to the middles of the voxels."""

    normals: NDArray[np.float64]
    """Directions in which the filled parts of the surrounding 125 voxels are thinnest [K,3]."""
    middles: NDArray[np.float64]
    """Centres of the surrounding 27 voxels, weighted with the filled fractions [K,3]."""
    inward: NDArray[np.float64]
    """Directions along the sheets, from the rims to the centres [K,3]."""
    length: NDArray[np.float64]
    """Fraction of the length of each voxel along `inward` that the sheet reaches into it [K]."""


def _find_sheets(parts: _Parts) -> tuple[NDArray[np.int64], _Sheets]:
    """Find the voxels that belong to thin sheets; return their numbers [K], and their sheets."""
    normal = parts.axes[:, :, 0]
    thin = (parts.layers * np.abs(normal).max(axis=1) < THIN) | parts.no_normal
    normal, around = normal[thin], parts.around[thin]
    centre = around @ NEAR / np.maximum(parts.total[thin], 1e-9)[:, None]
    along = centre - (centre * normal).sum(axis=1, keepdims=True) * normal
    away = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    # Across a rim, three columns of voxels are filled over the lengths 0, l and 1. The distance
    # of their centre is 1 / (1 + l).
    length = np.clip(1 / away - 1, SHORTEST, 1)
    return parts.number[thin], _Sheets(normal, centre, along / away[:, None], length)


def _fill_sheets(
    padded: NDArray,
    index: NDArray[np.int64],
    chosen: NDArray[np.int64],
    sheets: _Sheets,
    shift: NDArray[np.float64],
    spread: NDArray[np.float64],
) -> None:
    """Set the centres [V,3] and second moments [V,3,3] of the voxels that belong to sheets.

    A sheet that passes through two layers of voxels fills them unequally. The middle of such a
    sheet is the centre of the filled parts, not of the whole voxels.

    Args:
        padded: Filled fractions, padded by 2 voxels.
        index: Indices of all voxels [V,3].
        chosen: Numbers of the K voxels that belong to sheets [K].
        sheets: The sheets in these voxels.
        shift: Centres of the filled parts [V,3]; those of other voxels are known.
        spread: Second moments of the filled parts [V,3,3].
    """
    at = tuple((index + 2).T)
    normal = sheets.normals
    # Neighbours at a rim are filled over a part of their length, but are as thick as the sheet.
    fraction = np.minimum(padded[at][chosen] / sheets.length, 1)
    some, depth, moved = np.arange(len(chosen)), np.full(len(chosen), np.inf), padded.copy()
    for _ in range(ROUNDS):
        place, across = index[chosen[some]], normal[some]
        total = _within(padded, place, 1).sum(axis=1)
        centre = np.zeros(place.shape)
        for axis in range(3):
            moved[at] = padded[at] * shift[:, axis]
            centre[:, axis] = _within(moved, place, 1).sum(axis=1)
        better = FASTER * (centre * across).sum(axis=1) / np.maximum(total, 1e-9)
        changed = np.abs(better - depth[some]) > NEARLY
        some, better, across = some[changed], better[changed, None], across[changed]
        depth[some] = better[:, 0]
        planes = _Surfaces(sheets.middles[some] + better * across, across, np.ones(len(some), bool))
        filled = _part_moments(fraction[some], planes, SAMPLES)
        shift[chosen[some]], spread[chosen[some]] = filled
    inward, missing = sheets.inward, (1 - sheets.length)[:, None]
    squares = np.einsum("ki,kij,kj->k", inward, spread[chosen], inward)
    shift[chosen] += missing * np.sqrt(3 * np.maximum(squares, 0))[:, None] * inward
    squeeze = np.eye(3) - missing[:, :, None] * inward[:, :, None] * inward[:, None, :]
    spread[chosen] = squeeze @ spread[chosen] @ squeeze


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


class _Surfaces(NamedTuple):
    """Surfaces in V voxels, with positions relative to the middles of the voxels."""

    middles: NDArray[np.float64]
    """A point of each plane, or of each rod's axis [V,3]."""
    axes: NDArray[np.float64]
    """Normals of the planes, or directions of the rods [V,3]."""
    sheet: NDArray[np.bool_]
    """Whether two parallel planes have the same distance from the point [V]."""
    rods: bool = False
    """Whether the surfaces are cylinders around the axes instead of planes."""


def _part_moments(
    fraction: NDArray[np.float64], surfaces: _Surfaces, samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [V,3] and second moments [V,3,3] of the parts below the surfaces.

    Args:
        fraction: Filled fractions of the voxels [V].
        surfaces: The surfaces in the voxels.
        samples: Number of sample points along each axis.
    """
    line = (np.arange(samples) + 0.5) / samples - 0.5
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    width = np.ones(len(fraction)) if surfaces.rods else np.abs(surfaces.axes).sum(axis=1)
    vectors = points, fraction, surfaces.middles, surfaces.axes
    centre, spread = np.zeros((len(fraction), 3)), np.zeros((len(fraction), 3, 3))
    compile_missing([fill_voxels])
    wp.launch(
        fill_voxels,
        -(-len(fraction) // AT_ONCE),
        [1 / samples, surfaces.rods, *map(_wrap, (*vectors, surfaces.sheet, width))],
        [_wrap(centre), _wrap(spread)],
        device="cpu",
    )
    return centre, spread


def _wrap(values: NDArray) -> wp.array:
    """Return a Warp array of numbers, vectors or matrices that uses the memory of a NumPy array."""
    kinds = {1: wp.float64, 2: wp.vec3d, 3: wp.mat33d}
    kind = wp.bool if values.dtype == bool else kinds[values.ndim]
    return wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu", copy=False)
