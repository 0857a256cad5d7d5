"""Divides the cells of a lattice among the parts of a body.

Without this division, each part would end at the border of a cell, with a wrong mass and bending
stiffness. A cell that several parts share occurs once for each part, with the same nodes, but with
points at the moments of the part's share. Shares are exact up to the size of a sample, a fraction
of a voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Particles
from phy124.particles.moments import PER_CELL, place_points, sum_groups
from phy124.particles.solid import Solid

LEAST = 1e-3
"""A smaller share of a cell has no points."""
SAMPLES, STEPS, MOST = 64, np.array([1, 19, 27]), 4_000_000
"""Each voxel at a border of parts is divided into `SAMPLES` samples, unless all samples would be
more than `MOST`. The samples are evenly spaced along each axis, so that borders parallel to the
faces of voxels are precise; `STEPS` minimises the correlation between the axes.
"""
INWARD = 1e-3
"""Smallest distance of the centre of a share from the faces of its cell [cells]."""


class Parts(NamedTuple):
    """The parts of a body."""

    find: Callable[[NDArray], NDArray[np.int32]]
    """Returns the index of the part at each position [M,3], m."""
    static: NDArray[np.bool_]
    """Whether each part is static. A cell belongs to a static part if its centre does, so static
    parts end at whole cells.
    """


class _Pieces(NamedTuple):
    """Voxels, or samples of voxels, each in a single part."""

    voxel: NDArray[np.int64]
    volume: NDArray[np.float64]
    x: NDArray[np.float64]
    part: NDArray[np.int64]
    second: NDArray[np.float64]
    """Second moments about `x`, divided by the volume [E,9], m^2."""

    def select(self, chosen: NDArray[np.bool_]) -> _Pieces:
        return _Pieces(
            self.voxel[chosen],
            self.volume[chosen],
            self.x[chosen],
            self.part[chosen],
            self.second[chosen],
        )


def divide_cells(
    points: Particles, solid: Solid, cell: NDArray[np.int64], parts: Parts, dx: float
) -> Particles:
    """Return the points with their part as material; repeat the cells that several parts share.

    Args:
        points: The integration points of the solid.
        solid: The body.
        cell: For each voxel of the solid, the index of its cell in `points`; -1: none [V].
        parts: The parts of the body.
        dx: Side of a cell [m].
    """
    centre, count = points.x.reshape(-1, PER_CELL, 3).mean(axis=1), len(parts.static)
    pieces = _pieces(solid, parts)
    pieces = pieces.select(cell[pieces.voxel] >= 0)
    holder, part = cell[pieces.voxel], pieces.part
    at_centre = parts.find(centre)[holder]
    part = np.where(parts.static[at_centre] | parts.static[part], at_centre, part)
    keys, share = np.unique(holder * count + part, return_inverse=True)
    share = share.reshape(-1)
    size, of = np.bincount(share, pieces.volume), keys // count
    kept = size >= LEAST * np.bincount(of, size)[of]
    keys, of, size = keys[kept], of[kept], size[kept]
    share = np.where(kept, np.cumsum(kept) - 1, -1)[share]
    divided = np.bincount(of)[of] > 1
    x = points.x.reshape(-1, PER_CELL, 3)[of]
    inside = (share >= 0) & divided[share]
    number = np.cumsum(divided) - 1
    placed = _place(pieces.select(inside), number[share[inside]], dx)
    # The nodes of a cell follow from the centre of its points.
    low = np.floor(centre[of[divided]] / dx)
    middle = placed.mean(axis=1) / dx
    placed += ((np.clip(middle, low + INWARD, low + 1 - INWARD) - middle) * dx)[:, None]
    x[divided] = placed
    fraction = size / np.bincount(of, size)[of]
    volume = points.volume[::PER_CELL][of] * fraction
    repeat = (PER_CELL * of[:, None] + np.arange(PER_CELL)).ravel()
    return replace(
        points,
        x=x.reshape(-1, 3),
        volume=np.repeat(volume, PER_CELL),
        density=points.density[repeat],
        material=np.repeat(keys % count, PER_CELL).astype(np.int32),
        gaussian=points.gaussian[repeat],
        copies=None if points.copies is None else points.copies[of],
    )


def find_excess(points: Particles, solid: Solid, parts: Parts) -> float:
    """Return the excess of the moving cells' volume over the moving material's volume. The excess
    is a fraction of the material's volume.

    `points` are the result of `divide_cells`. It is negative if the cells have too little volume.
    """
    pieces = _pieces(solid, parts)
    volume = pieces.volume[~parts.static[pieces.part]].sum()
    cells = points.volume[~parts.static[points.material]].sum()
    return float(cells / volume - 1) if volume > 0 else 0.0


def _pieces(solid: Solid, parts: Parts) -> _Pieces:
    index, fraction, _, shift, spread = solid.voxels
    middle, volume = (index + solid.first + 0.5 + shift) * solid.voxel, fraction * solid.voxel**3
    part = parts.find(middle)
    border = _at_borders(index, part)
    if border.sum() * SAMPLES > MOST:
        border[:] = False
    voxel, cut = np.flatnonzero(~border), np.flatnonzero(border)
    # The material of a voxel is replaced by a parallelepiped with the same moments.
    size, axes = np.linalg.eigh(12 * spread[cut])
    sides = (axes * np.sqrt(np.maximum(size, 0))[:, None]) @ np.swapaxes(axes, 1, 2)
    unit = (np.arange(SAMPLES)[:, None] * STEPS % SAMPLES + 0.5) / SAMPLES - 0.5
    samples = (middle[cut, None] + solid.voxel * unit @ sides).reshape(-1, 3)
    second = np.concatenate(
        [spread[voxel].reshape(-1, 9) * solid.voxel**2, np.zeros((len(samples), 9))]
    )
    return _Pieces(
        np.concatenate([voxel, np.repeat(cut, SAMPLES)]),
        np.concatenate([volume[voxel], np.repeat(volume[cut] / SAMPLES, SAMPLES)]),
        np.concatenate([middle[voxel], samples]),
        np.concatenate([part[voxel], parts.find(samples)]).astype(np.int64),
        second,
    )


def _at_borders(index: NDArray[np.int64], part: NDArray) -> NDArray[np.bool_]:
    """Return a mask of the voxels with neighbours that belong to another part [V]."""
    shape = index.max(axis=0) + 1
    low, high = np.full(shape, part.max(initial=0)), np.full(shape, part.min(initial=0))
    low[tuple(index.T)] = high[tuple(index.T)] = part
    least = scipy.ndimage.minimum_filter(low, 3, mode="nearest")
    most = scipy.ndimage.maximum_filter(high, 3, mode="nearest")
    border: NDArray[np.bool_] = (least != most)[tuple(index.T)]
    return border


def _place(pieces: _Pieces, share: NDArray[np.int64], dx: float) -> NDArray[np.float64]:
    """Return the eight points of each share [S,8,3], m."""
    count = int(share.max(initial=-1)) + 1
    filled = np.bincount(share, pieces.volume, count)[:, None]
    centre = sum_groups(share, pieces.volume[:, None] * pieces.x, count) / filled
    arm = pieces.x - centre[share]
    second = (arm[:, :, None] * arm[:, None]).reshape(-1, 9) + pieces.second
    second = sum_groups(share, pieces.volume[:, None] * second, count) / filled
    return place_points(centre, second.reshape(-1, 3, 3), dx)
