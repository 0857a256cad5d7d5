"""Computes the material in the voxels of a new grid from the surface of a solid.

The new voxels keep the volume, the centre and the second moments of the solid.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.particles.cubes import Cubes, Surface
from phy124.particles.cuts import moments_below

ROUNDING = 1e-9
"""Borders of voxels that differ by less count as equal [voxels]."""
SMALLEST = 1e-6
"""A part of a cube is ignored if one of its sides is shorter than this [new voxels]."""


class Material(NamedTuple):
    """The material in V voxels; lengths are in voxels."""

    voxel: NDArray[Any]
    """Indices in the flattened grid, in ascending order [V]."""
    fraction: NDArray[Any]
    shift: NDArray[Any]
    """Centres of the filled parts, relative to the middles of the voxels [V,3]."""
    spread: NDArray[Any]
    """Second moments of the filled parts about their centres, divided by the volumes [V,3,3]."""


class _Moments(NamedTuple):
    """Moments of parts of cubes about the middles of the new voxels."""

    voxel: NDArray[Any]
    """Indices of the new voxels in the flattened grid [K]."""
    volume: NDArray[Any]
    first: NDArray[Any]
    second: NDArray[Any]

    def select(self, mask: NDArray[np.bool_]) -> _Moments:
        return _Moments(*(values[mask] for values in self))


def average(
    values: NDArray, first: NDArray[Any], voxel: float, step: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the mean values in the voxels of another grid. The size of these voxels may differ.

    Args:
        values: Values of voxels [X,Y,Z]; zero elsewhere.
        first: Index of the first voxel [3]; its lower corner is at `first * voxel`.
        voxel: Side of the voxels [m].
        step: Side of the other voxels [m].

    Returns:
        The index of the first of the other voxels [3], and the mean values [X,Y,Z].
    """
    mean, firsts = values.astype(np.float64), []
    for axis, start in enumerate((first * voxel).tolist()):
        old = start + voxel * np.arange(mean.shape[axis] + 1)
        low = math.floor(old[0] / step + ROUNDING)
        high = math.ceil(old[-1] / step - ROUNDING)
        firsts.append(low)
        summed = np.cumsum(np.moveaxis(mean, axis, 0), axis=0)
        summed = np.concatenate([np.zeros_like(summed[:1]), summed])
        at = np.clip((step * np.arange(low, high + 1) - old[0]) / voxel, 0, len(old) - 1)
        below = np.minimum(at.astype(np.int64), len(old) - 2)
        part = (at - below)[:, None, None]
        edges = (1 - part) * summed[below] + part * summed[below + 1]
        mean = np.moveaxis(np.diff(edges, axis=0) * voxel / step, 0, axis)
    return np.array(firsts), mean


def move_material(
    full: NDArray[Any],
    surface: Surface,
    low: NDArray[Any],
    side: float,
    inner: NDArray[np.bool_],
) -> Material:
    """Return the material in the voxels of a new grid.

    Args:
        full: Full voxels of the old grid [F,3]; those within `inner` may be missing.
        surface: The material of voxels at the surface.
        low: Lower corner of the old grid, relative to that of the new grid [3], in new voxels.
        side: Side of an old voxel, in new voxels.
        inner: New voxels that are full [X,Y,Z].
    """
    shape = inner.shape
    moments = [_divide_even(low + side * full, side, np.ones(len(full)), shape)]
    for cubes, parts in surface.cubes:
        moments += _move_cubes(cubes, low, side, side / parts, shape)
    outer = [each.select(~inner.ravel()[each.voxel]) for each in moments]
    every = _Moments(*map(np.concatenate, zip(*outer, _full_voxels(inner), strict=True)))
    voxel, which = np.unique(every.voxel, return_inverse=True)
    volume = np.bincount(which, every.volume)
    centre = np.stack([np.bincount(which, moment) for moment in every.first.T], axis=1)
    centre /= volume[:, None]
    spread = np.empty((len(voxel), 3, 3))
    for i, j in itertools.combinations_with_replacement(range(3), 2):
        mean = np.bincount(which, every.second[:, i, j]) / volume
        spread[:, i, j] = spread[:, j, i] = mean - centre[:, i] * centre[:, j]
    return Material(voxel, volume, centre, spread)


def _full_voxels(inner: NDArray[np.bool_]) -> _Moments:
    voxel = np.flatnonzero(inner)
    count = len(voxel)
    second = np.tile(np.eye(3) / 12, (count, 1, 1))
    return _Moments(voxel, np.ones(count), np.zeros((count, 3)), second)


def _move_cubes(
    cubes: Cubes, low: NDArray, side: float, size: float, shape: tuple[int, ...]
) -> list[_Moments]:
    """Divide cubes with a side of `size` new voxels, and return the moments of their parts."""
    reach = size * np.abs(cubes.normal).sum(axis=1) / 2
    upper, lower = side * cubes.upper, side * cubes.lower
    some = (cubes.weight > 0) & (upper > -reach) & (lower < reach) & (upper > lower)
    even = (upper >= reach) & (lower <= -reach)
    whole, cut = cubes.select(some & even), cubes.select(some & ~even)
    level = ((low + side * cut.corner + size / 2) * cut.normal).sum(axis=1)
    return [
        _divide_even(low + side * whole.corner, size, whole.weight, shape),
        _divide_cut(cut, level, low, side, size, shape),
    ]


def _divide_even(corner: NDArray, size: float, weight: NDArray, shape: tuple[int, ...]) -> _Moments:
    """Divide evenly filled cubes with lower corners `corner` [B,3] and filled fractions `weight`
    [B].
    """
    which, voxel, middle, sides = _divide(corner, size)
    volume = sides.prod(axis=1) * weight[which]
    second = middle[:, :, None] * middle[:, None, :] + np.eye(3) * (sides**2 / 12)[:, None]
    flat = np.asarray(np.ravel_multi_index(tuple(voxel.T), shape))
    return _Moments(flat, volume, volume[:, None] * middle, volume[:, None, None] * second)


def _divide_cut(
    cubes: Cubes, level: NDArray, low: NDArray, side: float, size: float, shape: tuple[int, ...]
) -> _Moments:
    """Divide cubes that are cut by planes; `level` is the height of each cube's middle [B]."""
    which, voxel, middle, sides = _divide(low + side * cubes.corner, size)
    normal = cubes.normal[which]
    # A box between planes becomes a cube by stretching.
    scaled = normal * sides
    length = np.linalg.norm(scaled, axis=1)
    height = level[which] - ((middle + voxel + 0.5) * normal).sum(axis=1)
    scaled /= length[:, None]
    part = moments_below(scaled, (height + side * cubes.upper[which]) / length)
    # In thick parts, the lower plane is outside of the box.
    below = (height + side * cubes.lower[which]) / length
    some = np.flatnonzero(below > -np.abs(scaled).sum(axis=1) / 2)
    for moment, excess in zip(part, moments_below(scaled[some], below[some]), strict=True):
        moment[some] -= excess
    filled = sides.prod(axis=1) * cubes.weight[which]
    volume, about = filled * part[0], filled[:, None] * sides * part[1]
    second = filled[:, None, None] * sides[:, :, None] * sides[:, None, :] * part[2]
    cross = middle[:, :, None] * (about + 0.5 * volume[:, None] * middle)[:, None, :]
    second += cross + cross.swapaxes(1, 2)
    kept = volume > SMALLEST**2
    flat = np.asarray(np.ravel_multi_index(tuple(voxel[kept].T), shape))
    first = about + volume[:, None] * middle
    return _Moments(flat, volume[kept], first[kept], second[kept])


def _divide(
    corner: NDArray, size: float
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Divide cubes with lower corners [B,3] at the borders of the new voxels.

    Returns:
        For each part: number of its cube [K], index of its voxel [K,3], its middle relative to the
        voxel's middle [K,3], and its sides [K,3].
    """
    first = np.floor(corner + SMALLEST).astype(np.int64)
    parts = []
    for step in itertools.product(range(math.ceil(size) + 1), repeat=3):
        voxel = first + step
        start, end = np.maximum(corner, voxel), np.minimum(corner + size, voxel + 1)
        which = np.flatnonzero((end - start > SMALLEST).all(axis=1))
        voxel, start, end = voxel[which], start[which], end[which]
        parts.append((which, voxel, (start + end - 1) / 2 - voxel, end - start))
    which, voxel, middle, sides = map(np.concatenate, zip(*parts, strict=True))
    return which, voxel, middle, sides
