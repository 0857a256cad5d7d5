"""Finds the stems of an object, and the material in their voxels.

The Gaussians of captured stems scatter, so in stems a few voxels thick, single voxels do not
determine a surface. A stem's cross-section is therefore the ellipse whose outline has the centre
and the second moments of the stem's samples across its axis. The unit of length is a voxel.

The moments are means in a ball that moves across the direction in which the samples extend
farthest, until its middle lies on the axis. At the border of a sheet, the ball moves into the
sheet. Parts of sheets are therefore not treated as stems.

In a cross-section wider than the ball, the ball can stay at the rim. The ellipse in this ball would
then extend beyond the rim, and into inner material whose surface consists of faces. Such a rim is
recognised if the samples of a voxel lie well inside the ellipse, and many other samples lie far
outside. The majority of the voxels nearby decides, since a cross-section of ellipses and faces may
have gaps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.cubes import Cubes, Samples, parts_of
from phy124.particles.dilation import dilate

Array = NDArray[Any]
Mask = NDArray[np.bool_]

REACHES = (1.75, 2.5)
"""Radii of the balls; the larger ball is used where there is no stem in the smaller ball [voxels].
"""
BALL = 2.0
"""Largest length of a ball-like Gaussian, relative to its thickness. Such Gaussians may fill a stem
instead of covering it, so they determine no ellipses.
"""
STEPS = 3
"""Number of balls in which each centre is computed."""
LONG = 0.5
"""Largest second moment across a stem, relative to the second moment along the stem."""
ROUND = 0.3
"""Smallest second moment across a stem, relative to the largest second moment across it."""
WIDEST = 0.7
"""Largest second moment across a stem [voxels^2]."""
LOOSE = 1.4
"""The limits above are multiplied by this factor until the balls have reached the axis."""
DEEP = 0.87
"""Largest level of the samples of a voxel at a rim (RMS). A point at the level L is L times as far
from the axis as the outline. Most voxels at rims have levels from 0.70 to 0.81.
"""
FAR = 1.5
"""Smallest level of samples far outside of an outline."""
MOST_FAR = 0.15
"""Largest share of the samples around a stem that may lie far outside of its outline. This share is
at most 0.11 in captured stems, and at least 0.19 at rims.
"""
AROUND = 1.2
"""Radius in which samples around a stem are counted, relative to the radius of the ball."""
ALIKE = 2
"""Radius in which the majority of a stem's voxels decides whether they are at a rim [voxels]."""
THICK = 2
"""Parts of an object in which a voxel is farther than this from the surface have no stems [voxels].
"""
STEM_PARTS = 3
"""Parts along each axis into which a voxel of a stem is divided."""
NEAR = 2
"""Largest distance of a stem's voxels without samples from those with samples [voxels]."""
UP = (0.0, 0.0, 1.0)
"""Normal of a plane at an axis."""
PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]
"""Index in `PAIRS` of each entry of a symmetric matrix."""


class _Axes(NamedTuple):
    """Axes of the stems in some voxels."""

    voxel: Array
    """Index of each voxel in the list of voxels [K]."""
    centre: Array
    """Points on the axes [K,3]."""
    outline: Array
    """Matrices Q [K,3,3]; a point x with (x - centre) Q (x - centre) = 1 is at the surface."""

    def select(self, which: Array) -> _Axes:
        return _Axes(*(values[which] for values in self))


def find_stems(region: Mask, border: Mask, samples: Samples) -> tuple[Cubes, Mask]:
    """Return the material of the border voxels in stems, and the mask of these voxels [X,Y,Z]."""
    voxel = np.asarray(np.ravel_multi_index(tuple(samples.points.astype(int).T), region.shape))
    thick = dilate(~dilate(~region, THICK), THICK)
    covers = (samples.lengths > BALL * samples.thickness)[samples.owner]
    used = (border & ~thick).ravel()[voxel] & covers
    every, moments = _sum_moments(voxel[used], samples, used)
    left, parts = np.arange(len(every)), []
    for reach in REACHES:
        parts.append(_find_axes(moments, left, reach))
        left = np.setdiff1d(left, parts[-1].voxel)
    axes = _Axes(*map(np.concatenate, zip(*parts, strict=True)))
    place = np.stack(np.unravel_index(every[axes.voxel], region.shape), axis=1)
    is_stem = np.zeros(region.shape, bool)
    is_stem[tuple(place.T)] = True
    occupied = np.zeros(region.shape, bool)
    occupied.ravel()[voxel] = True
    gaps = np.argwhere(border & ~occupied & dilate(is_stem, NEAR))
    if len(gaps):
        # A voxel without samples belongs to a stem if the nearest voxel with samples does.
        others = np.argwhere(occupied & ~is_stem)
        _, nearest = scipy.spatial.KDTree(np.concatenate([place, others])).query(gaps)
        of_stem = nearest < len(place)
        axes = axes.select(np.concatenate([np.arange(len(place)), nearest[of_stem]]))
        place = np.concatenate([place, gaps[of_stem]])
        is_stem[tuple(place.T)] = True
    return _fill_voxels(axes, place, region.shape), is_stem


def _sum_moments(voxel: Array, samples: Samples, used: Mask) -> tuple[Array, Array]:
    """Return the V voxels of the samples in a mask, and the sums of the samples' opacities,
    positions and products of coordinates [V,10].
    """
    x = samples.points[used].astype(np.float64)
    weight = samples.opacities[samples.owner[used]].astype(np.float64)
    every, which = np.unique(voxel, return_inverse=True)
    columns = [weight, *(weight * x.T), *(weight * x[:, i] * x[:, j] for i, j in PAIRS)]
    return every, np.stack([np.bincount(which, column) for column in columns], axis=1)


def _find_axes(moments: Array, voxel: Array, reach: float) -> _Axes:
    """Return the axes of the stems in balls of radius `reach` that start in some voxels."""
    middle = moments[:, 1:4] / moments[:, :1]
    tree, centre = scipy.spatial.KDTree(middle), middle[voxel]
    values, axes = np.zeros((len(voxel), 3)), np.zeros((len(voxel), 3, 3))
    for step in range(STEPS):
        near = scipy.spatial.KDTree(centre).sparse_distance_matrix(
            tree, reach, output_type="ndarray"
        )
        weight = (1 - (near["v"] / reach) ** 2) ** 2
        shape = len(centre), len(middle)
        sums = scipy.sparse.csr_matrix((weight, (near["i"], near["j"])), shape=shape) @ moments
        mean, second = _central_moments(sums)
        values, axes = np.linalg.eigh(second)
        along, shift = axes[:, :, 2], mean - centre
        centre = mean - (shift * along).sum(axis=1)[:, None] * along
        loose = LOOSE if step < STEPS - 1 else 1
        small, large, longest = values.T
        is_stem = (large < np.minimum(LONG * longest, WIDEST) * loose) & (
            small > ROUND / loose * large
        )
        voxel, centre, values, axes = (each[is_stem] for each in (voxel, centre, values, axes))
    # The outline of an ellipse with semi-axes a and b has the second moments a^2 / 2 and b^2 / 2.
    outline = np.einsum("kia,ka,kja->kij", axes[:, :, :2], 0.5 / values[:, :2], axes[:, :, :2])
    stems = _Axes(voxel, centre, outline)
    return stems.select(~_are_at_rims(stems, moments, tree, reach))


def _central_moments(sums: Array) -> tuple[Array, Array]:
    """Return the means [K,3] and central second moments [K,3,3] from sums over samples [K,10]."""
    mean = sums[:, 1:4] / sums[:, :1]
    second = (sums[:, 4:] / sums[:, :1])[:, FULL].reshape(-1, 3, 3)
    return mean, second - mean[:, :, None] * mean[:, None, :]


def _are_at_rims(axes: _Axes, moments: Array, tree: scipy.spatial.KDTree, reach: float) -> Mask:
    """Return whether each ellipse fits only the rim of a wider cross-section [K]."""
    mean, second = _central_moments(moments[axes.voxel])
    arm = mean - axes.centre
    second += arm[:, :, None] * arm[:, None, :]
    is_deep = np.einsum("kij,kij->k", axes.outline, second) < DEEP**2
    near = scipy.spatial.KDTree(axes.centre).sparse_distance_matrix(
        tree, AROUND * reach, output_type="ndarray"
    )
    stem, other = near["i"], near["j"]
    arm, weight = tree.data[other] - axes.centre[stem], moments[other, 0]
    is_far = np.einsum("pi,pij,pj->p", arm, axes.outline[stem], arm) > FAR**2
    around, far = (np.bincount(stem, w, len(mean)) for w in (weight, weight * is_far))
    is_at_rim = is_deep & (far > MOST_FAR * around)
    place = scipy.spatial.KDTree(tree.data[axes.voxel])
    groups = place.query_ball_point(place.data, ALIKE)
    return np.array([is_at_rim[group].mean() for group in groups]) > 0.5


def _fill_voxels(axes: _Axes, place: Array, shape: tuple[int, ...]) -> Cubes:
    """Return the material in the voxels with indices `place` [K,3]. Each part of a voxel is cut by
    a plane.
    """
    corner = parts_of(place, STEM_PARTS)
    arm = corner + 0.5 / STEM_PARTS - axes.centre[:, None]
    slope = np.einsum("kij,kpj->kpi", axes.outline, arm).reshape(-1, 3)
    level = np.sqrt(np.maximum((slope * arm.reshape(-1, 3)).sum(axis=1), 0))
    steep = np.linalg.norm(slope, axis=1)
    normal = slope / np.maximum(steep, 1e-9)[:, None]
    normal[steep < 1e-9] = UP
    # The distance from the outline is, to first order, (level - 1) / |gradient of level|.
    upper = np.clip((1 - level) * level / np.maximum(steep, 1e-9), -1, 1)
    voxel = np.repeat(np.ravel_multi_index(tuple(place.T), shape), STEM_PARTS**3)
    ones = np.ones(len(voxel))
    return Cubes(voxel, corner.reshape(-1, 3), ones, normal, upper, -ones)
