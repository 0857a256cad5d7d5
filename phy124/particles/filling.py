"""Finds the voxels inside the surface of an object.

- The grid is flooded from outside; voxels that the flood does not reach are inside. The samples are
  then dilated by increasing radii r (in voxels), and the flood is repeated. Dilation seals gaps of
  width up to 2 r. Larger dilations are used only if they enclose a new cavity; other narrow slots
  stay open. Wide openings are never sealed.
- If no radius encloses a cavity of more than `CAVITY` times the volume of the surface, the shell is
  open (a missing back or bottom). A voxel is then also inside if axis-parallel rays from the voxel
  meet the dilated shell in at least five of the six directions. The inside of a vessel whose walls
  have two sides remains empty (phy124/particles/vessels.py).
- An interior that would be bounded mostly by openings, such as that of a cage, remains empty.
- The cavity of a closed shell remains empty if the shell is a wall with two sides.

The mode `solid` fills all these cavities, and the mode `shell` fills only gaps between close walls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.cubes import Samples
from phy124.particles.dilation import dilate
from phy124.particles.vessels import is_vessel

Mask = NDArray[np.bool_]
Inside = Literal["auto", "solid", "shell"]

SEAL = 0.065
"""Half of the width of the widest sealed gap, relative to the object's longest side."""
CAVITY = 0.5
"""Smallest volume of the cavities of a closed shell, relative to the volume of the surface; an open
shell may have small sealed parts, such as knobs.
"""
COVERED = 0.5
"""Smallest fraction of the border of an interior that is surface rather than a sealed opening."""
NESTED = 3
"""If most of a cavity's border is farther from the outside, the shell may have two walls [voxels].
"""


@dataclass(frozen=True, eq=False)
class Grid:
    """Samples of an object's Gaussians in the voxels of a grid."""

    first: NDArray[np.int64]
    """Index of the grid's first voxel [3]."""
    voxel: float
    """Side of a voxel [m]."""
    across: float
    """Longest side of the object [voxels]."""
    samples: Samples
    means: NDArray
    """Centres of the Gaussians [N,3], m."""
    occupied: Mask
    """Voxels with samples [X,Y,Z]."""

    def select(self, chosen: Mask) -> Grid:
        """Return the voxels of the chosen Gaussians [N]."""
        mine = chosen[self.samples.owner]
        points, owner = self.samples.points[mine], self.samples.owner[mine]
        occupied = np.zeros_like(self.occupied)
        occupied[tuple(points.astype(np.int32).T)] = True
        samples = self.samples._replace(points=points, owner=owner)
        return replace(self, samples=samples, occupied=occupied)


def find_inside(grid: Grid, inside: Inside) -> tuple[Mask, float]:
    """Return the mask of the voxels inside the object [X,Y,Z], and which fraction of them lies in
    cavities of a shell with openings.
    """
    region, bridged = _find_inside(grid, inside)
    return region, float((bridged & region).sum() / region.sum())


def _find_inside(grid: Grid, inside: Inside) -> tuple[Mask, Mask]:
    """Return the masks of the voxels inside the object [X,Y,Z], and of those in cavities of a shell
    with openings.
    """
    occupied, widest = grid.occupied, max(1, int(SEAL * grid.across))
    least = CAVITY * occupied.sum()
    surface, cavity = _seal(occupied, 1)
    bridged = hollow = np.zeros_like(occupied)
    if inside == "shell":
        return surface & ~_find_wide_cavities(occupied, surface, cavity, widest), bridged
    is_open = bool(cavity.sum() <= least)
    if inside == "auto" and not is_open:
        hollow = _find_hollows(grid, surface, cavity, least)
    region = surface
    for r in sorted({r for r in (2, 3, widest // 2, widest) if 1 < r <= widest}):
        sealed, cavity = _seal(occupied, r)
        if is_open and cavity.sum() > least:
            is_open = False
            enclosed = _find_enclosed(_close(occupied, 1)) & ~occupied
            bridged = _grow(cavity, r, sealed, enclosed) & ~surface
            if inside == "auto" and not _is_covered(bridged, surface):
                return region, hollow
            if inside == "auto":
                hollow = bridged & ~_without_vessels(bridged, grid)
            region = region | bridged
        else:
            region = region | dilate(cavity & ~region, r) & sealed
    if is_open:
        bridged = _find_open_interior(grid, surface, widest, inside)
    return (region | bridged) & ~hollow, bridged


def _seal(occupied: Mask, radius: int) -> tuple[Mask, Mask]:
    """Return a shell with its sealed gaps and its inside, and the inside farther than `radius` from
    the shell.
    """
    thick = dilate(occupied, radius)
    outside = _flood_outside(~thick)
    return ~dilate(outside, radius), ~(outside | thick)


def _find_open_interior(grid: Grid, surface: Mask, widest: int, inside: Inside) -> Mask:
    """Return the interior of an open shell.

    Rays pass through the gaps of a shell of few Gaussians, unless the shell is dilated.
    """
    enclosed = _find_enclosed(_close(grid.occupied, 1))
    if _deep_parts(enclosed & ~surface).sum() > CAVITY * grid.occupied.sum():
        for r in range(1, widest + 1):
            thick = dilate(grid.occupied, r)
            cavity = _deep_parts(_find_enclosed(thick) & ~thick & ~surface)
            sealed = ~dilate(~(thick | cavity), r)
            interior = _grow(cavity, r, sealed, enclosed & ~grid.occupied) & ~surface
            if _is_covered(interior, surface):
                return interior if inside == "solid" else _without_vessels(interior, grid)
    return np.zeros_like(surface)


def _find_wide_cavities(occupied: Mask, surface: Mask, cavity: Mask, widest: int) -> Mask:
    """Return the cavities that are wider than 2 `widest` voxels anywhere."""
    core = ~dilate(~surface | occupied, widest)
    return dilate(_select_parts(cavity, core), 1) & ~occupied


def _find_hollows(grid: Grid, surface: Mask, cavity: Mask, least: float) -> Mask:
    """Return the cavities of at least `least` voxels in closed walls that have two sides."""
    near_outside = dilate(~surface, NESTED)
    labels, _ = scipy.ndimage.label(cavity)  # pyright: ignore
    hollow = np.zeros_like(surface)
    for part in np.flatnonzero(np.bincount(labels.ravel()) > least):
        here = labels == part
        is_nested = part > 0 and near_outside[here & dilate(grid.occupied, 2)].mean() < 0.5
        if is_nested and is_vessel(grid.means, grid.samples.normals, _find_nearby(grid, here)):
            hollow |= here
    return dilate(hollow, 1) & ~grid.occupied


def _grow(cavity: Mask, radius: int, sealed: Mask, enclosed: Mask) -> Mask:
    """Return a cavity with the parts of the interior that are closer than `radius` to the surface.

    A dilation reaches only the surface of wide parts. In narrow parts, such as legs, the interior
    is enclosed and connected to the cavity.
    """
    return _select_parts(sealed & enclosed, cavity) | dilate(cavity, radius) & sealed


def _is_covered(interior: Mask, surface: Mask) -> bool:
    """Return whether a surface covers at least the fraction `COVERED` of an interior's border."""
    border = scipy.ndimage.binary_dilation(interior) & ~interior
    return bool((border & surface).sum() >= COVERED * border.sum())


def _close(mask: Mask, radius: int) -> Mask:
    """Return a mask without gaps of width up to 2 `radius` (morphological closing)."""
    return ~dilate(~dilate(mask, radius), radius)


def _flood_outside(free: Mask) -> Mask:
    labels, _ = scipy.ndimage.label(free)  # pyright: ignore
    return labels == labels[0, 0, 0]


def _find_enclosed(surface: Mask) -> Mask:
    hits = np.zeros(surface.shape, np.uint8)
    for axis in range(3):
        hits += np.logical_or.accumulate(surface, axis=axis)
        back = np.flip(surface, axis)
        hits += np.flip(np.logical_or.accumulate(back, axis=axis), axis)
    return hits >= 5


def _deep_parts(mask: Mask) -> Mask:
    """Return the connected parts of a mask that contain 3 x 3 x 3 voxels.

    Discs at the rim of a plate may enclose a layer above the plate.
    """
    return _select_parts(mask, ~dilate(~mask, 1))


def _select_parts(mask: Mask, seeds: Mask) -> Mask:
    """Return the connected parts of a mask that contain a seed."""
    labels, count = scipy.ndimage.label(mask)  # pyright: ignore
    chosen = np.zeros(count + 1, bool)
    chosen[labels[seeds]] = True
    chosen[0] = False
    parts: Mask = chosen[labels]
    return parts


def _without_vessels(cavity: Mask, grid: Grid) -> Mask:
    """Return a cavity without its connected parts that are inside open vessels or touch no surface.

    Walls that are far apart may enclose a part in the free air between them.
    """
    labels, count = scipy.ndimage.label(cavity)  # pyright: ignore
    is_shell = np.zeros(count + 1, bool)
    for part in range(1, count + 1):
        near = _find_nearby(grid, labels == part)
        is_shell[part] = len(near) > 0 and not is_vessel(grid.means, grid.samples.normals, near)
    parts: Mask = is_shell[labels]
    return parts


def _find_nearby(grid: Grid, part: Mask) -> NDArray[np.int64]:
    """Return the Gaussians with samples at most two voxels from a part of the grid."""
    cells = tuple(grid.samples.points.astype(np.int32).T)
    return np.unique(grid.samples.owner[dilate(part, 2)[cells]])
