"""Computes for each voxel of a body its outward normal, and moments of the filled part.

A partly filled voxel is cut by a plane with the voxel's normal. At an edge between sides that are
parallel to faces of the voxels, the filled part is a box. In a thin sheet, the voxel is cut by two
parallel planes (phy124/particles/sheets.py). In a rod without full voxels, the voxel is cut by a
cylinder. The material of an object made of Gaussians is known and need not be estimated
(phy124/particles/resampling.py).
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.voxels import AT_ONCE, fill_voxels
from phy124.particles.cuts import fill_between
from phy124.particles.resampling import Material
from phy124.particles.sheets import Planes, fill_sheets
from phy124.runtime.compiling import compile_missing

SHEET = 0.25
"""If the length of the gradient of the filled fraction [1/voxel] is below this value, the voxel
belongs to a sheet.
"""
THIN = 1.2
"""Thickness below which a part of a body counts as a sheet, which has two surfaces in the same
voxel [voxels].
"""
FULL = 0.999
"""A voxel with at least this filled fraction cannot belong to a sheet or a rod."""
NOISE = 1e-4
"""The middle plane of a sheet is not improved in a voxel with at most this filled fraction;
resampling leaves many such voxels.
"""
VEIL = 0.15
"""The middle planes of a sheet are not improved if its thickness is at most this [voxels]."""
ROUND = 3.5
"""Largest cross-section of a part of a body that counts as a rod [voxels^2]."""
WIDE = 0.45
"""Largest second moment, across a rod, of the material in the surrounding 125 voxels [voxels^2]."""
LONG = 2.5
"""Smallest ratio of the second moment along a rod to the second moment across it."""
SINGLE = math.pi / 4
"""Largest cross-section of a rod that can lie in only two neighbouring columns of voxels
[voxels^2].
"""
EMPTY, EXACT = 0.02, 0.05
"""`EMPTY`: voxels beyond the sides of a box have at most this fraction of the material in a voxel
at the edge. `EXACT`: largest difference between a box's volume and the filled fraction of its
voxel, relative to the filled fraction.
"""
SAMPLES, FINER = 6, 10
"""Number of sample points along each axis of a partly filled voxel: in general, and in voxels of
rods.
"""
NEAR, FAR = (np.array(list(np.ndindex(*3 * (2 * n + 1,)))) - n for n in (1, 2))
"""Steps from a voxel to the 27 voxels within one step, and to the 125 voxels within two steps."""
AXES = np.array([9, 3, 1])
"""For each axis, the index in `NEAR` of a voxel's next neighbour, minus the index of the voxel
itself.
"""
SLOPES = 3 / 13 * NEAR / np.maximum((NEAR**2).sum(axis=1, keepdims=True), 1)
"""Weights with which the filled fractions of the 27 voxels around a voxel are summed to their
gradient. The weight of a neighbour is proportional to 1 / distance^2. At a plane parallel to a face
of the voxels, the gradient has the length 1.
"""


class Voxels(NamedTuple):
    """The filled parts of the V voxels that are not empty; the unit of length is a voxel."""

    indices: NDArray[np.int64]
    """Indices of the voxels [V,3]."""
    fraction: NDArray[np.float64]
    """Filled fractions [V]."""
    normal: NDArray[np.float64]
    """Outward normals of the voxels [V,3]; zero in sheets, which have no single outward side."""
    shift: NDArray[np.float64]
    """Centres of the voxels' filled parts, relative to the middles of the voxels [V,3]."""
    spread: NDArray[np.float64]
    """Second moments of the voxels' filled parts about their centres, divided by the parts' volumes
    [V,3,3].
    """


def find_voxels(filled: NDArray, material: Material | None = None) -> Voxels:
    """Return the filled parts of the voxels of a grid from their filled fractions [X,Y,Z].

    Args:
        filled: Filled fractions [X,Y,Z].
        material: Centres and second moments of the filled parts, if they are known.
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
    if material is not None:  # in the same order
        return Voxels(index, fraction, normal, material.shift, material.spread)
    part = fraction[outer] < 1
    cut, around = outer[part], around[part]
    parts = _Parts(padded, index[cut], around, np.logical_not(normal[cut].any(axis=1)))
    number, across, middle = _find_sheets(parts)
    single = np.delete(cut, number)
    planes = _Surfaces(np.zeros((len(single), 3)), normal[single])
    shift[single], spread[single] = _part_moments(fraction[single], planes, SAMPLES)
    at_edge, centres, sides = _find_edges(fraction[single], np.delete(around, number, axis=0))
    shift[single[at_edge]] = centres
    spread[single[at_edge]] = np.eye(3) * sides[:, None] ** 2 / 12
    thick = np.zeros(len(index) + 1)
    thick[cut[parts.number]] = np.where(np.isfinite(parts.thick), parts.thick, 0)
    sheets, planes = cut[number], Planes.through(across, middle)
    some = (fraction[sheets] > NOISE) & (thick[sheets] > VEIL)
    veil = fill_between(fraction[sheets[~some]], planes.normal[~some], planes.height[~some])
    shift[sheets[~some]], spread[sheets[~some]] = veil
    planes = Planes(*(values[some] for values in planes))
    fill_sheets(padded, index, sheets[some], planes, thick, shift, spread)
    number, axis, middle = _find_rods(parts)
    rods, surfaces = cut[number], _Surfaces(middle, axis, rods=True)
    shift[rods], spread[rods] = _part_moments(fraction[rods], surfaces, FINER)
    return Voxels(index, fraction, normal, shift, spread)


def _within(padded: NDArray, index: NDArray, steps: int) -> NDArray[np.float64]:
    """Return the values of a grid at the neighbours of each voxel [V,S].

    The neighbours are `NEAR` (one step) or `FAR` (two steps).

    The grid is padded by two voxels.
    """
    side = 2 * steps + 1
    cubes = np.lib.stride_tricks.sliding_window_view(padded, (side, side, side))
    return cubes[tuple((index + 2 - steps).T)].reshape(len(index), side**3)


def _find_edges(
    fraction: NDArray[np.float64], around: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the voxels in which the filled part is a box, at an edge of the body.

    Along each axis across a side of the body, the voxel has an empty neighbour and a fuller
    neighbour. The box ends at the side, so that the ratio of both filled fractions is the length of
    the box. A single plane, which would be slanted, would make second moments too small.

    Args:
        fraction: Filled fractions of the voxels [V].
        around: Filled fractions of the 27 voxels around each voxel [V,27].

    Returns:
        Numbers of the K voxels [K]; the centres of the boxes, relative to the voxels' middles
        [K,3]; and the lengths of the boxes' sides [K,3].
    """
    before, after = (around[:, len(NEAR) // 2 + sign * AXES] for sign in (-1, 1))
    full, empty = np.maximum(before, after), np.minimum(before, after)
    f = fraction[:, None]
    across = (empty <= EMPTY * f) & (full >= f)
    length = np.where(across, f / np.maximum(full, f), 1)
    off = np.abs(length.prod(axis=1) - fraction) > EXACT * fraction
    chosen = np.flatnonzero((across.sum(axis=1) > 1) & ~off)
    length, towards = length[chosen], np.sign(after - before)[chosen]
    return chosen, towards * (1 - length) / 2, length


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
        """Indices of the K voxels among the V voxels [K]."""
        self.around, self.total = around[self.number], total[self.number]
        self.layers, self.no_normal = layers[self.number], no_normal[self.number]
        # With only two layers of voxels, a sheet's normal could not be distinguished from a
        # direction across the sheet's rim.
        weight = _within(padded, index[self.number], 2)
        wide = weight.sum(axis=1, keepdims=True)
        weight /= np.maximum(wide, 1e-9)
        self.middle = weight @ FAR
        """Centres of the material in the 125 voxels around each voxel [K,3]."""
        second = (weight @ (FAR[:, :, None] * FAR[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        second -= self.middle[:, :, None] * self.middle[:, None, :]
        self.moment, self.axes = np.linalg.eigh(second)
        """Second moments of the material in these 125 voxels, in ascending order [K,3], and their
        axes [K,3,3].
        """
        most = np.abs(self.axes[:, :, 0]).max(axis=1)
        self.thick, self.thickest = self.layers * most, wide[:, 0] / 25 * most
        """Thicknesses of sheets, computed from the material of 27 and of 125 voxels [K]."""


def _find_sheets(
    parts: _Parts,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Find the voxels that belong to thin sheets.

    Returns:
        Numbers of the K voxels [K]; the directions in which the filled parts of the surrounding 125
        voxels are thinnest [K,3]; and the centres of the surrounding 27 voxels, weighted with the
        filled fractions, relative to the voxels' middles [K,3].
    """
    normal = parts.axes[:, :, 0]
    # Next to a thick body, voxels with a trace of material have thin surroundings.
    thin = (np.maximum(parts.thick, parts.thickest) < THIN) | parts.no_normal
    centre = parts.around[thin] @ NEAR / np.maximum(parts.total[thin], 1e-9)[:, None]
    return parts.number[thin], normal[thin], centre


def _find_rods(parts: _Parts) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
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
    """For each voxel, a point on the plane of its surface, or on the axis of its rod [V,3]."""
    axes: NDArray[np.float64]
    """For each voxel, the normal of the plane of its surface, or the direction of its rod [V,3]."""
    rods: bool = False
    """Whether the surfaces in the voxels are cylinders around the axes instead of planes."""


def _part_moments(
    fraction: NDArray[np.float64], surfaces: _Surfaces, samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [V,3] and second moments [V,3,3] of the voxels' parts below the surfaces.

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
        [1 / samples, surfaces.rods, *map(_wrap, (*vectors, width))],
        [_wrap(centre), _wrap(spread)],
        device="cpu",
    )
    return centre, spread


def _wrap(values: NDArray) -> wp.array:
    """Return a Warp array of numbers, vectors or matrices that uses the memory of a NumPy array."""
    kind = {1: wp.float64, 2: wp.vec3d, 3: wp.mat33d}[values.ndim]
    return wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu", copy=False)
