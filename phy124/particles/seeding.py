"""Places the particles and computes their volumes.

The solid's volume in each lattice cell is divided evenly among the particles in the cell. Small
volumes do not affect stability, because the limit of the substep depends on stiffness and density.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError, TooFine
from phy124.gaussians import Gaussians, Particles
from phy124.particles.solid import Solid, find_interior, find_solid

BINDINGS = ("lattice", "particles")
MAX_PARTICLES = 8_000_000
THIN = 4
"""Largest width of a thin part of an object, in particle spacings."""
MOST_CELLS = 50_000_000
"""Largest number of cells of a grid in memory."""
SMALLEST = 0.01
"""Smallest volume of a particle, relative to the mean."""


def make_particles(
    gaussians: Gaussians,
    interior: Solid | None = None,
    *,
    density: float,
    spacing: float,
    binding: str = "lattice",
) -> Particles:
    """Make particles for clean Gaussians in metres (see `clean`, `scale_to_size`).

    Args:
        gaussians: The object, N Gaussians.
        interior: Interior of the object (`find_interior`), if already known.
        density: Mass density, kg/m^3.
        spacing: Distance between particles, m: grid spacing / particles per cell and axis.
        binding: `lattice`: a lattice, denser in thin parts; `particles`: one particle per Gaussian,
            and a lattice in the interior.

    Raises:
        InputError: If a number is not positive, or if the binding is unknown.
        TooFine: If the object could need more than `MAX_PARTICLES` particles.
    """
    _check(density, spacing, binding)
    shape = (interior or find_interior(gaussians)).resample(spacing)
    room = _room_per_cell(shape, spacing)
    lattice = _lattice(shape, room, spacing)
    if binding == "particles":
        lattice = _keep_apart(lattice, gaussians.means, 0.5 * spacing)
        x = np.concatenate([gaussians.means, lattice])
        owner = np.concatenate([np.arange(len(gaussians)), np.full(len(lattice), -1)])
    else:
        x = _lattice_with_gaussians(gaussians, lattice, shape, spacing)
        owner = np.full(len(x), -1)
    x = x.astype(np.float32)
    order = _order_by_cell(x, 2 * spacing)
    x, owner = x[order], owner[order]
    islands = shape.islands(2 * spacing)
    return Particles(
        x=x,
        volume=_share_volume(x, shape, room),
        density=np.full(len(x), float(density)),
        material=np.zeros(len(x), np.int32),
        gaussian=owner.astype(np.int32),
        piece=None if islands.number == 1 else islands.at(x),
    )


def fill(gaussians: Gaussians, spacing: float) -> NDArray[np.float64]:
    """Return the points [M,3], m, of the lattice (i + 1/2) * spacing inside a closed shape."""
    _check(1.0, spacing, BINDINGS[0])
    shape = find_solid(gaussians, spacing)
    return _lattice(shape, _room_per_cell(shape, spacing), spacing)


def is_in_box(x: NDArray, low: NDArray, high: NDArray) -> NDArray[np.bool_]:
    """Return the mask of points [P,3], m, in a closed box from `low` [3] to `high` [3]."""
    inside: NDArray[np.bool_] = (x >= np.asarray(low)) & (x <= np.asarray(high))
    return np.logical_and.reduce(inside, axis=1)


def _check(density: float, spacing: float, binding: str) -> None:
    for name, value, unit in (("density", density, "kg/m^3"), ("spacing", spacing, "m")):
        if not (np.isfinite(value) and value > 0):
            limit = f"it must be a positive number [{unit}]."
            raise InputError(name, value, limit, f"Choose a positive {name}.")
    if binding not in BINDINGS:
        limit = f"there is no such binding; the bindings are {' and '.join(BINDINGS)}."
        raise InputError("binding", binding, limit, "Choose one of these bindings.")


def _lattice(shape: Solid, room: _Room, spacing: float) -> NDArray[np.float64]:
    cells, n = room.cells, round(room.side / spacing)
    if len(cells) * n**3 > MAX_PARTICLES:
        raise TooFine(
            "spacing",
            f"{spacing:.3g} m",
            f"the object would take up to {len(cells) * n**3:.3g} particles; "
            f"the limit is {MAX_PARTICLES:,}.",
            "Choose a coarser grid (a lower accuracy) or fewer particles per cell.",
        )
    within = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    chunk, inside = max(1, 500_000 // n**3), []
    for start in range(0, len(cells), chunk):
        index = (cells[start : start + chunk, None] * n + within).reshape(-1, 3)
        points = (index + 0.5) * spacing
        inside.append(points[shape.contains(points)])
    return np.concatenate(inside)


def _keep_apart(points: NDArray, others: NDArray, distance: float) -> NDArray:
    if len(points) == 0:
        return points
    tree = scipy.spatial.KDTree(others, balanced_tree=False)  # built in half the time
    nearest, _ = tree.query(points, distance_upper_bound=distance, workers=-1)
    return points[np.isinf(nearest)]


def _lattice_with_gaussians(
    gaussians: Gaussians, lattice: NDArray, shape: Solid, spacing: float
) -> NDArray[np.float64]:
    """Return lattice points, and Gaussians in parts that are thin or without lattice points.

    Thin parts would tear if their particles were one grid cell apart.
    """
    means = gaussians.means.astype(np.float64)
    thin = shape.thin(means, THIN * spacing)
    close, others = _cell_means(means[thin], 0.5 * spacing), means[~thin]
    lattice = _keep_apart(lattice, close, 0.5 * spacing) if len(close) else lattice
    if len(lattice):
        # A Gaussian in the cell of a lattice point is closer to this point than the spacing.
        missed = _keep_apart(_outside_cells(others, lattice, spacing), lattice, spacing)
    else:
        missed = others
    return np.concatenate([lattice, close, _cell_means(missed, spacing)])


def _outside_cells(points: NDArray, lattice: NDArray, side: float) -> NDArray[np.float64]:
    place = np.floor(lattice / side).astype(np.int64)
    low = place.min(axis=0)
    shape = place.max(axis=0) - low + 1
    if shape.prod() > MOST_CELLS:
        return points
    full = np.zeros(shape, bool)
    full[tuple((place - low).T)] = True
    cells = np.floor(points / side).astype(np.int64) - low
    inside = ((cells >= 0) & (cells < shape)).all(axis=1)
    inside[inside] = full[tuple(cells[inside].T)]
    return points[~inside]


def _cell_means(points: NDArray, side: float) -> NDArray[np.float64]:
    if not len(points):
        return points
    cells = np.floor(points / side).astype(np.int64)
    low = cells.min(axis=0)
    shape = tuple(cells.max(axis=0) - low + 1)
    flat = np.ravel_multi_index(tuple((cells - low).T), shape)
    if math.prod(shape) <= MOST_CELLS:
        every = np.bincount(flat)
        count = every[every > 0]
        which = (np.cumsum(every > 0) - 1)[flat]
    else:
        _, which, count = np.unique(flat, return_inverse=True, return_counts=True)
    sums = [np.bincount(which, points[:, k], minlength=len(count)) for k in range(3)]
    return np.stack(sums, axis=1) / count[:, None]


def _order_by_cell(x: NDArray, side: float) -> NDArray[np.int64]:
    cells = np.floor((x - x.min(axis=0)) / side).astype(np.int64)
    return np.lexsort(cells.T[::-1])


def _share_volume(x: NDArray[np.float32], shape: Solid, room: _Room) -> NDArray[np.float64]:
    cells, side = room.cells, room.side
    cell = np.floor(x / side + 1e-6).astype(np.int64)
    low = np.minimum(cells.min(axis=0), cell.min(axis=0))
    size = np.maximum(cells.max(axis=0), cell.max(axis=0)) - low + 1
    cell_key = np.ravel_multi_index(tuple((cells - low).T), tuple(size))
    keys, which, count = np.unique(
        np.ravel_multi_index(tuple((cell - low).T), tuple(size)),
        return_inverse=True,
        return_counts=True,
    )
    place = np.minimum(np.searchsorted(keys, cell_key), len(keys) - 1)
    empty = keys[place] != cell_key
    inside = np.bincount(place[~empty], room.volume[~empty], minlength=len(keys))
    volume = inside[which] / count[which]
    if empty.any():
        _, nearest = scipy.spatial.KDTree(x).query((cells[empty] + 0.5) * side, workers=-1)
        volume += np.bincount(nearest, room.volume[empty], minlength=len(x))
    volume = np.maximum(volume, SMALLEST * volume.mean())
    return volume * (shape.volume / volume.sum())


class _Room(NamedTuple):
    side: float
    """Side of a cell [m]."""
    cells: NDArray[np.int64]
    """Indices of the cells that contain part of the solid [L,3]."""
    volume: NDArray[np.float64]
    """Volume of the solid in each cell [L], m^3."""


def _room_per_cell(shape: Solid, spacing: float) -> _Room:
    side = max(spacing, shape.voxel)
    inside = np.argwhere(shape.fraction > 0)
    per_cell = round(side / shape.voxel)
    cells = (inside + shape.first) // per_cell
    part = shape.fraction[tuple(inside.T)].astype(np.float64) * shape.voxel**3
    low = cells.min(axis=0)
    size = tuple(cells.max(axis=0) - low + 1)
    flat = np.ravel_multi_index(tuple((cells - low).T), size)
    keys = np.flatnonzero(np.bincount(flat))
    cells = np.stack(np.unravel_index(keys, size), axis=1) + low
    return _Room(side, cells, np.bincount(flat, part)[keys].astype(np.float64))
