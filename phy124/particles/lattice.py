"""Computes the integration points and surface points of a body on a lattice at rest.

The body is divided into cubic cells of side dx, from i dx to (i + 1) dx along each axis. Each cell
has eight points of equal volume, at `c +- s1 e1 +- s2 e2 +- s3 e3`. Here c is the centre of the
part of the body in the cell; s^2 and e are the eigenvalues and eigenvectors of this part's second
moments per volume. In a full cell, the points are the 2 x 2 x 2 Gauss points. Without exact second
moments, plates thinner than a cell would be too stiff.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import TooFine
from phy124.particles.moments import PER_CELL, place_points, sum_groups
from phy124.particles.pieces import find_copies, find_pieces
from phy124.particles.protrusions import find_protrusions
from phy124.particles.seeding import MAX_PARTICLES, Particles
from phy124.particles.shares import Parts, divide_cells
from phy124.particles.solid import MEMORY, Solid
from phy124.particles.voxels import find_normals

SMALLEST = 1e-3
"""Smallest filled fraction of a cell with integration points."""
FULLEST = 0.1
"""In thin needles, `SMALLEST` is replaced by this multiple of the filled fraction of the fullest
cell.
"""
HAZE = 0.005
"""A cell with a smaller filled fraction contains only stray Gaussians."""
TRACE = 0.1
"""A voxel has no surface points if its filled fraction is below this value and a neighbouring voxel
is twice as full.
"""
SLIVER, THIN_SLIVER = 0.15, 0.05
"""A cell is a sliver if its filled fraction is below `THIN_SLIVER` f^2 or below `SLIVER` g^2. Here
f is the filled fraction of the fullest cell around the cell, and g is the smallest filled fraction
in a block of 2 x 2 x 2 cells that touches the cell. If `SLIVER` were used for both limits, plates
turned by 45 degrees would bend up to 1.11 times too far. With a fixed limit, rods would bend up to
3.1 times too far.
"""
AROUND = np.array([s for s in np.ndindex(3, 3, 3) if s != (1, 1, 1)]) - 1
APART = 0.5
"""Distance between neighbouring surface points [cells]."""


def lattice_of(solid: Solid, *, density: float, dx: float, parts: Parts | None = None) -> Particles:
    """Return the integration and surface points of a solid whose voxels align with the cells.

    Args:
        solid: The body; the side of its voxels is an integer fraction or an integer multiple of dx.
        density: Mass density [kg/m^3].
        dx: Side of a cell [m].
        parts: The parts of the body; the material of each point is then the index of its part.

    Raises:
        TooFine: The solid needs more than `MAX_PARTICLES` points.
    """
    if solid.volume / dx**3 * PER_CELL > MAX_PARTICLES:
        limit = f"the object would need more than {MAX_PARTICLES:,} integration points."
        raise TooFine("accuracy.cells", f"{dx:.3g} m per cell", limit, "Choose fewer cells.")
    pieces = []
    for points, subdivided, cell in _lattices_of(solid, dx):
        if parts is not None:
            points = _cut_to_moving(points, subdivided, cell, parts, dx)
            points = divide_cells(points, subdivided, cell, parts, dx)
        pieces.append(points)
    points = pieces[0] if len(pieces) == 1 else _join(pieces)
    return replace(points, density=np.full(len(points), float(density)))


@lru_cache(MEMORY)
def _lattices_of(solid: Solid, dx: float) -> list[tuple[Particles, Solid, NDArray[np.int64]]]:
    """Return, for each separate piece, its points, its solid with voxels no larger than a cell, and
    each voxel's cell [V].
    """
    return [_lattice_of(_subdivide(piece, dx), dx) for piece in solid.split(dx)]


def _cut_to_moving(
    points: Particles, solid: Solid, cell: NDArray[np.int64], parts: Parts, dx: float
) -> Particles:
    """Return the points without the surface points of static parts."""
    moving = ~parts.static[parts.find(points.x.reshape(-1, PER_CELL, 3).mean(axis=1))]
    assert points.surface is not None
    if moving.all():
        return points
    if not moving.any():
        return replace(points, surface=points.surface[:0])
    # The last entry is for voxels without a cell.
    rows = _cut_surface(solid, np.append(moving, False)[cell], dx)
    protrusions = points.surface[points.surface[:, 7] > 0]
    protrusions = protrusions[~parts.static[parts.find(protrusions[:, :3])]]
    return replace(points, surface=np.concatenate([rows, protrusions]))


def _join(pieces: list[Particles]) -> Particles:
    """Join separate pieces, which use different copies of common nodes."""
    copies, first = [], 0
    for piece in pieces:
        empty = np.zeros((len(piece) // PER_CELL, 27), np.int16)
        copies.append(first + (empty if piece.copies is None else piece.copies.astype(np.int16)))
        first = int(copies[-1].max()) + 1
    arrays = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ("x", "volume", "density", "material", "gaussian", "surface")
    }
    counts = [len(piece) for piece in pieces]
    number = np.repeat(np.arange(len(pieces), dtype=np.int32), counts)
    return Particles(**arrays, copies=np.concatenate(copies), piece=number)


def _lattice_of(solid: Solid, dx: float) -> tuple[Particles, Solid, NDArray[np.int64]]:
    cells = _find_cells(solid, dx)
    x, volume, copies, cell = _points_of_pieces(solid, dx, cells)
    count = len(x)
    points = Particles(
        x=x.astype(np.float32),
        volume=volume,
        density=np.ones(count),
        material=np.zeros(count, np.int32),
        gaussian=np.full(count, -1, np.int32),
        surface=_add_protrusions(_surface_points(solid, dx, cells), solid, dx),
        copies=copies,
    )
    for array in vars(points).values():
        if array is not None:
            array.flags.writeable = False  # All runs use this array.
    return points, solid, cell


def _add_protrusions(points: NDArray, solid: Solid, dx: float) -> NDArray[np.float64]:
    """Return the surface points [S,6], followed by the K protrusions, as rows [S + K,8]."""
    protrusions = find_protrusions(solid.source or solid, points, dx)
    if len(protrusions):
        protrusions = _outermost(protrusions, APART * dx)
    return np.concatenate([_rows_of(points), _rows_of(protrusions, is_protrusion=True)])


def _cut_surface(solid: Solid, kept: NDArray[np.bool_], dx: float) -> NDArray[np.float64]:
    """Return the surface points of the voxels that are kept [V], as rows [S,8]."""
    fraction = np.zeros(solid.fraction.shape, np.float32)
    fraction[tuple(solid.voxels.indices.T)] = solid.voxels.fraction * kept
    return _rows_of(surface_points(Solid(solid.first, solid.voxel, fraction), dx))


def _rows_of(points: NDArray, *, is_protrusion: bool = False) -> NDArray[np.float64]:
    """Return points with normals [S,6] as rows [S,8] of `Particles.surface`."""
    tail = np.tile((0.0, float(is_protrusion)), (len(points), 1))
    return np.concatenate([points, tail], axis=1)


def cells_of(points: Particles) -> Particles:
    """Return one particle for each cell, instead of the eight points of the cell."""
    centre = points.x.reshape(-1, PER_CELL, 3).mean(axis=1)
    return Particles(
        x=centre,
        volume=points.volume.reshape(-1, PER_CELL).sum(axis=1),
        density=points.density[::PER_CELL],
        material=points.material[::PER_CELL],
        gaussian=points.gaussian[::PER_CELL],
        cell=np.arange(len(centre)),
        piece=None if points.piece is None else points.piece[::PER_CELL],
    )


def points_of(cells: Particles, points: Particles) -> Particles:
    """Return the points of some cells, with the materials of the cells."""
    cell = cells.cell
    assert cell is not None
    index = (PER_CELL * cell[:, None] + np.arange(PER_CELL)).reshape(-1)
    return Particles(
        x=points.x[index],
        volume=points.volume[index],
        density=np.repeat(cells.density, PER_CELL),
        material=np.repeat(cells.material, PER_CELL),
        gaussian=points.gaussian[index],
        body=None if cells.body is None else np.repeat(cells.body, PER_CELL),
        surface=points.surface,
        copies=None if points.copies is None else points.copies[cell],
        piece=None if cells.piece is None else np.repeat(cells.piece, PER_CELL),
    )


def repeat_for_points(values: NDArray | None) -> NDArray | None:
    """Repeat each cell's value [C] for the cell's eight points [8C]."""
    return None if values is None else np.repeat(values, PER_CELL, axis=0)


class _Cells(NamedTuple):
    place: NDArray[np.int64]
    """Index of each voxel's cell [V,3]."""
    part: NDArray[np.float64]
    """Filled volume of each voxel, relative to a cell [V]."""
    number: NDArray[np.int64]
    """Index of each voxel's cell after slivers have been merged [V]; x varies slowest."""
    clear: NDArray[np.bool_]


def _find_cells(solid: Solid, dx: float) -> _Cells:
    index, fraction = solid.voxels[:2]
    place = np.floor((index + solid.first) * (solid.voxel / dx) + 1e-9).astype(np.int64)
    part = fraction * (solid.voxel / dx) ** 3
    return _Cells(place, part, _merge_slivers(place, part), _clear(solid))


def _points_of_pieces(
    solid: Solid, dx: float, cells: _Cells
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8] | None, NDArray[np.int64]]:
    """Return the integration points of all cells [8C,3], m, their volumes [8C], m^3,
    `Particles.copies` [C,27], and the cell of each voxel, or -1 [V].

    A cell occurs once for each of its separate pieces.
    """
    index, fraction, _, shift, spread = solid.voxels
    side = solid.voxel
    middle = (index + solid.first + 0.5 + shift) * side
    place, part, number, clear = cells
    pieces = find_pieces(index, place, number, part, clear[tuple(index.T)], SLIVER)
    piece = pieces.of_voxel
    count = int(piece.max()) + 1
    filled = np.bincount(piece, fraction, count)
    centre = sum_groups(piece, fraction[:, None] * middle, count) / filled[:, None]
    arm = middle - centre[piece]
    second = arm[:, :, None] * arm[:, None, :] + spread * side**2
    second = sum_groups(piece, (fraction[:, None, None] * second).reshape(-1, 9), count)
    second = second.reshape(-1, 3, 3) / filled[:, None, None]
    x = place_points(centre, second, dx)
    volume = filled * side**3
    # As in RestLattice, so that node indices agree.
    used = np.floor((x.astype(np.float32).astype(np.float64) / dx).mean(axis=1)).astype(np.int64)
    copies = find_copies(pieces, used, place, part)
    kept = volume >= min(SMALLEST * dx**3, FULLEST * volume.max())
    volume = volume[kept] * (solid.volume / volume[kept].sum())
    x = x[kept].reshape(-1, 3)
    copies = None if copies is None else copies[kept]
    cell = np.where(kept, np.cumsum(kept) - 1, -1)[piece]
    return x, np.repeat(volume / PER_CELL, PER_CELL), copies, cell


def _clear(solid: Solid) -> NDArray[np.bool_]:
    """Return a mask without the nearly empty voxels that resampling leaves around the body."""
    filled = _fractions(solid)
    fullest = scipy.ndimage.maximum_filter(filled, 3, mode="constant")
    clear: NDArray[np.bool_] = filled >= np.clip(fullest / 2, SMALLEST, TRACE)
    return clear


def _fractions(solid: Solid) -> NDArray[np.float64]:
    filled = np.zeros(solid.fraction.shape)
    filled[tuple(solid.voxels.indices.T)] = solid.voxels.fraction
    return filled


def surface_points(solid: Solid, dx: float) -> NDArray[np.float64]:
    """Return surface points [S,3], m, and outward normals, as rows of six numbers [S,6].

    The normal is zero on sheets, which have no single outward side.
    """
    return _surface_points(solid, dx, _find_cells(solid, dx))


def _surface_points(solid: Solid, dx: float, cells: _Cells) -> NDArray[np.float64]:
    index, fraction, normal, _, _ = solid.voxels
    filled, cell = cells.clear, cells.number
    outside = (filled & ~scipy.ndimage.binary_erosion(filled))[tuple(index.T)]
    clear = outside & (np.bincount(cell, cells.part) >= HAZE)[cell]
    outside = (
        clear if clear.any() else outside
    )  # In a needle, all cells may have such a small fraction.
    index, fraction, normal = index[outside], fraction[outside], normal[outside]
    # Behind nearly empty voxels, which are left out, full voxels are at the surface.
    full = np.flatnonzero(~normal.any(axis=1) & (fraction > 1 - TRACE))
    normal[full] = find_normals(np.where(filled, _fractions(solid), 0), index[full], TRACE / 2)
    across = solid.voxel * np.abs(normal).sum(axis=1)
    out = normal * ((fraction - 0.5) * across)[:, None]
    x = (index + solid.first + 0.5) * solid.voxel + out
    rows = np.concatenate([x, normal], axis=1)
    if solid.voxel > 1.2 * APART * dx:
        rows = _spread_along(rows, solid.voxel / 4)
    return _outermost(rows, APART * dx)


def _merge_slivers(place: NDArray[np.int64], part: NDArray) -> NDArray[np.int64]:
    """Return the index of each voxel's cell [V]; slivers are merged with a neighbouring cell.

    The nodes of a sliver are light, and light nodes would shorten the substep.
    """
    low, size = place.min(axis=0) - 1, tuple((np.ptp(place, axis=0) + 3).tolist())
    flat = np.asarray(np.ravel_multi_index(tuple((place - low).T), size))
    filled = np.bincount(flat, part, math.prod(size)).reshape(size)
    most = scipy.ndimage.maximum_filter(filled, 3, mode="constant")
    # The smallest fraction in each block of 2 x 2 x 2 cells; then the largest of the blocks that
    # contain or touch a cell.
    block = scipy.ndimage.minimum_filter(filled, 2, mode="constant", origin=-1)
    core = scipy.ndimage.maximum_filter(block, 4, mode="constant")
    slivers = filled < np.maximum(SLIVER * core**2, THIN_SLIVER * most**2)
    sliver = np.argwhere(slivers & (filled > 0))
    fullest, target = np.zeros(len(sliver)), sliver.copy()
    for step in AROUND:
        at = tuple((sliver + step).T)
        near = filled[at] / np.abs(step).sum()
        fuller = ~slivers[at] & (near > fullest)
        fullest[fuller], target[fuller] = near[fuller], (sliver + step)[fuller]
    moved = np.arange(filled.size)
    moved[np.ravel_multi_index(tuple(sliver.T), size)] = np.ravel_multi_index(tuple(target.T), size)
    cell = moved[flat]
    taken = np.zeros(filled.size, bool)
    taken[cell] = True
    return (np.cumsum(taken) - 1)[cell]


def _subdivide(solid: Solid, dx: float) -> Solid:
    parts = round(solid.voxel / dx)
    if parts <= 1:
        return solid
    if solid.source is not None:
        return solid.source.resample(solid.voxel / parts)
    fraction = solid.fraction
    for axis in range(3):
        fraction = np.repeat(fraction, parts, axis=axis)
    return Solid(solid.first * parts, solid.voxel / parts, fraction)


def _spread_along(rows: NDArray, distance: float) -> NDArray[np.float64]:
    normal = rows[:, 3:]
    helper = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = np.cross(normal, first)
    copies = []
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        moved = rows[:, :3] + distance * (a * first + b * second)
        copies.append(np.concatenate([moved, normal], axis=1))
    return np.concatenate(copies)


def _outermost(rows: NDArray, side: float) -> NDArray[np.float64]:
    """Return the outermost point in each cube with a side length [m]; in a cube with both faces of
    a thin part, return the outermost point of each face.
    """
    cube = np.floor(rows[:, :3] / side - 1e-6).astype(np.int64)
    low, size = cube.min(axis=0), np.ptp(cube, axis=0) + 1
    number = np.asarray(np.ravel_multi_index((cube - low).T, size))
    first, which = _highest(rows, number)
    behind = np.flatnonzero((rows[:, 3:] * rows[first[which], 3:]).sum(axis=1) < 0)
    second, _ = _highest(rows[behind], number[behind])
    return rows[np.concatenate([first, behind[second]])]


def _highest(rows: NDArray, cube: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index of the outermost point in each of C cubes [C], and the number of each
    point's cube, from 0 to C - 1 [S].
    """
    _, which = np.unique(cube, return_inverse=True)
    count = which.max(initial=-1) + 1
    mean = sum_groups(which, rows, count) / np.bincount(which, minlength=count)[:, None]
    height = ((rows[:, :3] - mean[which, :3]) * mean[which, 3:]).sum(axis=1)
    order = np.lexsort((-height, which))
    return order[np.flatnonzero(np.diff(which[order], prepend=-1))], which
