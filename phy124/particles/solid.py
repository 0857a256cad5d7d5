"""Finds the solid that Gaussians enclose, as a filled fraction of each voxel.

The Gaussians of each separate piece (phy124/particles/islands.py) enclose a part of the solid. The
Gaussians may be a shell of flat discs with gaps, a fuzzy cloud, thin sheets, or a mixture. The
interior is found in these steps:

- Each Gaussian is sampled within one standard deviation, at least once per voxel.
- The voxels inside the surface are found (phy124/particles/filling.py).
- Only the part of a surface voxel below the local surface belongs to the solid
  (phy124/particles/surface.py).

The voxels depend only on the Gaussians, so the solid does not depend on the simulation grid. The
solid is resampled to voxels that are aligned with the particle lattice (i + 1/2) * spacing. The
side of these voxels is the particle spacing multiplied or divided by an integer. `MAX_VOXELS` and
`MAX_SAMPLES` limit time and memory.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, rotation_matrices
from phy124.particles.cleaning import VISIBLE
from phy124.particles.cubes import Samples, Surface
from phy124.particles.dilation import dilate
from phy124.particles.filling import SEAL, Grid, Inside, find_inside
from phy124.particles.islands import Islands, divide, find_islands
from phy124.particles.resampling import Material, average, move_material
from phy124.particles.surface import find_surface, shortest_axes
from phy124.particles.voxels import Voxels, find_voxels

Mask = NDArray[np.bool_]

MAX_VOXELS = 4_000_000
MAX_SAMPLES = 6_000_000
ACROSS = 64
"""Number of voxels along the longest side; fewer if the Gaussians are too sparse."""
COARSER = 1.2
"""Factor on the side of a voxel if samples are not connected."""
CONNECTED = 6
"""A surface or cloud is connected if an occupied voxel has on average at least this number of
occupied neighbours (of 26).
"""
WHOLE = 1 - 1e-9
MEMORY = 2
"""Number of solids that are kept for later runs with the same objects."""


@dataclass(frozen=True, eq=False)
class Solid:
    """The interior of an object, as filled fractions of voxels."""

    first: NDArray[np.int64]
    """Index of the grid's first voxel [3]; its lower corner is at first * voxel [m]."""
    voxel: float
    """Side of a voxel [m]."""
    fraction: NDArray[np.float32]
    """Fraction of each voxel that is inside the object [X,Y,Z], 0..1."""
    surface: Surface | None = None
    """Material of the voxels at the surface. If None, the material is that of `source`; without
    `source`, all voxels are filled evenly.
    """
    source: Solid | None = None
    """The solid from which this solid was resampled."""
    means: NDArray[np.float32] | None = None
    """Centres of the visible Gaussians of the solid [K,3], m; None: those of `source`."""
    parts: tuple[Solid, ...] = ()
    """Parts with separate closed surfaces; empty: a single part."""
    bridged: float = 0.0
    """Fraction of the volume that lies in cavities of a shell with openings, 0..1."""

    @cached_property
    def voxels(self) -> Voxels:
        """The filled parts of the solid's voxels."""
        origin = self.source if self.surface is None else self
        if origin is None:
            return find_voxels(self.fraction)
        material = origin._move_to(self.voxel)
        filled = np.zeros(self.fraction.shape)
        filled.ravel()[material.voxel] = material.fraction
        return find_voxels(filled, material)

    @cached_property
    def _resampled(self) -> dict[float, Solid]:
        return {}

    def islands(self, dx: float) -> Islands:
        """Return the separate pieces of the solid for cells of side dx [m]."""
        return _find_islands(self.source or self, dx)

    def split(self, dx: float) -> list[Solid]:
        """Return the separate pieces of the solid for cells of side dx [m]."""
        origin, islands = self.source or self, self.islands(dx)
        if islands.number == 1:
            return [self]
        every = [
            [
                part._select(labels == k, islands)
                for part, labels in zip(origin.parts or (origin,), islands.of_parts, strict=True)
                if (part.fraction[labels == k] > 0).any()
            ]
            for k in range(islands.number)
        ]
        pieces = [_unite(parts) for parts in every]
        return pieces if self.source is None else [each._on_voxels(self.voxel) for each in pieces]

    def _select(self, mask: Mask, islands: Islands) -> Solid:
        surface, means = self.surface, self.means
        if surface is not None:
            groups = ((cubes.select(mask.flat[cubes.voxel]), n) for cubes, n in surface.cubes)
            surface = Surface(tuple(groups))
        if means is not None:
            means = means[mask[islands.voxels_at(means)]]
        fraction = np.where(mask, self.fraction, np.float32(0))
        return Solid(self.first, self.voxel, fraction, surface, means=means)

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        return float(self.fraction.sum(dtype=np.float64)) * self.voxel**3

    def contains(self, points: NDArray) -> Mask:
        """Return the mask of points [M,3], m, at which the interpolated fraction exceeds 1/2."""
        at = np.asarray(points, dtype=np.float64) / self.voxel - self.first - 0.5
        return scipy.ndimage.map_coordinates(self.fraction, at.T, order=1) > 0.5

    def thin(self, points: NDArray, width: float) -> Mask:
        """Return a mask of the points [M,3], m, outside the solid or in parts thinner than `width`
        [m].
        """
        radius = max(1, round(0.5 * (width / self.voxel - 1)))
        if 2 * radius >= min(self.fraction.shape):
            return np.ones(len(points), bool)
        core = ~dilate(self.fraction <= 0.5, radius)
        # The dilation is larger than the erosion, because cubes do not reach into rounded thick
        # parts.
        thick = dilate(core, radius + max(1, radius // 2))
        at = np.floor(np.asarray(points) / self.voxel).astype(np.int64) - self.first
        return ~thick[tuple(np.clip(at, 0, np.array(thick.shape) - 1).T)]

    def resample(self, spacing: float, *, per_cell: int = 1) -> Solid:
        """Return the solid with voxels of about the same size, aligned with particles `spacing` m
        apart.

        There are `per_cell` spacings in a grid cell, and no voxel crosses the faces of a cell.
        """
        ratio = spacing / self.voxel
        count = round(1 / ratio) if ratio <= 1 else 1
        step = spacing / round(ratio) if ratio > 1 else spacing * max(1, count - count % per_cell)
        if step not in self._resampled:
            self._resampled[step] = self._on_voxels(step)
        return self._resampled[step]

    def _on_voxels(self, step: float) -> Solid:
        first, fraction = average(self.fraction, self.first, self.voxel, step)
        source = None if self.surface is None else self
        return Solid(first, step, fraction.astype(np.float32), source=source)

    def _move_to(self, step: float) -> Material:
        assert self.surface is not None
        full = self.fraction > 0
        for cubes, _ in self.surface.cubes:
            full.ravel()[cubes.voxel] = False
        first, inner = average(full, self.first, self.voxel, step)
        at_border = full & dilate(~full, math.ceil(step / self.voxel) + 1)
        side = self.voxel / step
        low = self.first * side - first
        return move_material(np.argwhere(at_border), self.surface, low, side, inner > WHOLE)


@lru_cache(2 * MEMORY)
def _find_islands(solid: Solid, dx: float) -> Islands:
    fractions = [part.fraction for part in solid.parts or (solid,)]
    return find_islands(solid.first, solid.voxel, fractions, dx)


def find_solid(gaussians: Gaussians, spacing: float) -> Solid:
    """Find the solid enclosed by clean Gaussians, for particles that are `spacing` m apart."""
    return find_interior(gaussians).resample(spacing)


_kept: dict[bytes, Solid] = {}
"""Solids by digest of the Gaussians; the solid used last is the last entry."""
_lock = threading.Lock()
"""Lock of `_kept`, because the jobs of the web page run in threads."""


def find_interior(gaussians: Gaussians, inside: Inside = "auto") -> Solid:
    """Find the solid that clean Gaussians enclose; the last `MEMORY` solids are kept.

    `inside` states whether cavities are filled (phy124/particles/filling.py).
    """
    digest = _digest(gaussians) + inside.encode()
    with _lock:
        solid = _kept.get(digest)
    solid = solid or _find_interior(gaussians, inside)
    with _lock:
        _kept.pop(digest, None)
        _kept[digest] = solid
        while len(_kept) > MEMORY:
            del _kept[next(iter(_kept))]
    return solid


def _digest(gaussians: Gaussians) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for array in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities):
        digest.update(array.tobytes())
    return digest.digest()


def _find_interior(gaussians: Gaussians, inside: Inside) -> Solid:
    opaque = gaussians.opacities >= VISIBLE
    some = gaussians.select(opaque) if opaque.any() else gaussians
    grid = _voxelise(some)
    samples = grid.samples
    piece = divide(samples.points, samples.owner, grid.means, grid.occupied.shape)
    parts = []
    for k in range(piece.max() + 1):
        part = grid if not piece.any() else grid.select(piece == k)
        region, bridged = find_inside(part, inside)
        surface = find_surface(region, region & dilate(~region, 1), part.samples)
        means = grid.means[piece == k] if piece.any() else some.means
        fraction = surface.fill(region)
        parts.append(Solid(grid.first, grid.voxel, fraction, surface, means=means, bridged=bridged))
    solid = _unite(parts)
    solid.fraction.flags.writeable = False  # All runs use this array.
    return solid


def _unite(parts: Sequence[Solid]) -> Solid:
    if len(parts) == 1:
        return parts[0]
    fraction = np.minimum(sum(part.fraction for part in parts), np.float32(1))
    groups = [part.surface.cubes for part in parts if part.surface is not None]
    surface = Surface(tuple(itertools.chain(*groups))) if groups else None
    means = [part.means for part in parts if part.means is not None]
    joined = np.concatenate(means) if means else None
    volume = sum(part.volume for part in parts)
    bridged = sum(part.bridged * part.volume for part in parts) / max(volume, 1e-300)
    first, voxel, parts = parts[0].first, parts[0].voxel, tuple(parts)
    return Solid(first, voxel, fraction, surface, None, joined, parts, bridged)


def _voxelise(gaussians: Gaussians) -> Grid:
    """Return the finest grid on which samples are connected, or else the finest grid of all."""
    # Every Gaussian has at least one sample; half of the samples remain for large Gaussians.
    gaussians = gaussians.select(slice(None, None, math.ceil(2 * len(gaussians) / MAX_SAMPLES)))
    extent = _extent(gaussians)
    finest, voxel = None, float(extent.max()) / ACROSS
    while finest is None or voxel <= 4 * finest.voxel:
        if _admissible(gaussians, voxel, extent):
            grid = _rasterise(gaussians, voxel, extent)
            finest = finest or grid
            if _mean_neighbours(grid.occupied) >= CONNECTED:
                return grid
        voxel *= COARSER
    return finest


def _extent(gaussians: Gaussians) -> NDArray[np.float64]:
    reach, ways = gaussians.longest.astype(np.float64), gaussians.means.T.astype(np.float64)
    return np.array([(way + reach).max() - (way - reach).min() for way in ways])


def _margin(across: float) -> int:
    return int(np.ceil(SEAL * across)) + 3


def _admissible(gaussians: Gaussians, voxel: float, extent: NDArray) -> bool:
    cells = np.ceil(extent / voxel) + 1 + 2 * _margin(extent.max() / voxel)
    if cells.prod() > MAX_VOXELS:
        return False
    return float(_samples_per_axis(gaussians, voxel).prod(axis=1).sum()) <= MAX_SAMPLES


def _samples_per_axis(gaussians: Gaussians, voxel: float) -> NDArray[np.float64]:
    """Return the odd number of samples along each axis of each Gaussian [N,3], about one
    per voxel.
    """
    sigma = gaussians.scales.astype(np.float64) / voxel
    return np.where(sigma > 0.25, 2 * np.ceil(sigma) + 1, 1)


def _rasterise(gaussians: Gaussians, voxel: float, extent: NDArray) -> Grid:
    across = float(extent.max() / voxel)
    points, owner = _sample(gaussians, voxel)
    cells = np.floor(points.min(axis=0)).astype(np.int64)
    first = cells - _margin(across)
    points = (points - first).astype(np.float32)
    shape = np.floor(points.max(axis=0)).astype(np.int64) + 1 + _margin(across)
    occupied = np.zeros(shape, bool)
    occupied[tuple(points.astype(np.int32).T)] = True
    axes, sizes = shortest_axes(gaussians), 2 * gaussians.scales.astype(np.float64) / voxel
    thickness, lengths = sizes.min(axis=1), sizes.max(axis=1)
    samples = Samples(points, owner, axes, thickness, gaussians.opacities, lengths)
    return Grid(first, voxel, across, samples, gaussians.means, occupied)


def _sample(gaussians: Gaussians, voxel: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return sample points [S,3], in voxels, and the Gaussian of each point [S]."""
    counts = _samples_per_axis(gaussians, voxel).astype(np.int64)
    key = counts @ np.array([1, 10**5, 10**10])
    points, owners = [], []
    for value in np.unique(key):
        members = np.flatnonzero(key == value)
        unit = _unit_ball(counts[members[0]])
        centres = gaussians.means[members].astype(np.float64) / voxel
        if len(unit) > 1:
            axes = rotation_matrices(gaussians.quats[members])
            axes *= gaussians.scales[members][:, None, :] / voxel
            centres = (centres[:, None] + np.einsum("nij,uj->nui", axes, unit)).reshape(-1, 3)
        points.append(centres)
        owners.append(np.repeat(members, len(unit)))
    return np.concatenate(points), np.concatenate(owners)


def _unit_ball(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return lattice points [U,3] in the unit ball, `counts` [3] along the axes."""
    axes = [np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in counts]
    unit = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return unit[(unit**2).sum(axis=1) <= 1 + 1e-9]


def _mean_neighbours(occupied: Mask) -> float:
    around = scipy.ndimage.uniform_filter(occupied.astype(np.float32), 3, mode="constant") * 27 - 1
    return float(around[occupied].mean())
