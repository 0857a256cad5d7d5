"""Finds the material in each voxel at the surface of an object, from samples of its Gaussians.

The samples of a voxel are divided into faces: groups with similar outward normals. The normal of a
sample is the shortest axis of its Gaussian, or else the direction from the centre of the material
around the sample.

The material of a voxel lies below a face. In a thin part, the material ends at the opposite face.
At a convex edge, the material is below both faces; at a concave edge, below at least one face. The
unit of length is a voxel. Stems have no faces (phy124/particles/stems.py).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, rotation_matrices
from phy124.particles.cubes import Cubes, Samples, Surface, parts_of
from phy124.particles.stems import STEM_PARTS, find_stems

Array = NDArray[Any]
Mask = NDArray[np.bool_]

FLAT = 0.3
"""A Gaussian is flat if its shortest standard deviation is less than this multiple of the second
shortest.
"""
WINDOW = 5
"""Side of the cube of material around a sample [voxels]."""
NOISE = 0.15
"""Distances of flat Gaussians from their face with this standard deviation count as noise [voxels].
"""
PARALLEL = 0.95
"""Smallest cosine of the angle between the normals of parallel faces."""
OPPOSITE = 0.7
"""Smallest cosine of the angle between a normal and the reversed normal of the opposite face."""
THICKEST = 3.0
"""Largest thickness of a part of an object for which an opposite face is searched [voxels]."""
ASIDE = 1.2
"""Largest distance between two opposite faces, perpendicular to the normal [voxels]."""
TOGETHER = 0.5
"""Opposite faces with a smaller difference in distance are averaged [voxels]."""
NEIGHBOURS = 32
THINNEST = 0.1
"""Smallest thickness of a sheet without an opposite face [voxels]."""
BEYOND = 0.2
"""Flat Gaussians may stick out beyond a convex edge by this distance [voxels]."""
PREFERRED = 0.6
"""The face of a neighbouring voxel is preferred if the part below that face is thinner than this
multiple of the part below the voxel's own face.
"""
PARTS = 2
"""Parts along each axis into which a voxel at an edge is divided."""
AT_ONCE = 100_000
"""Number of rotation matrices in memory at one time."""
UP = (0.0, 0.0, 1.0)
"""Normal of a sample that lies at the centre of the material around it, as a single sample does."""
AROUND = [step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]
"""Steps to the 26 neighbours, from the lower corner of the block of 27 voxels."""


class _Faces(NamedTuple):
    voxel: Array
    """Index of each face's voxel in the flattened grid [K]."""
    side: Array
    """Index, 0 to 5, of the side of a cube to which each normal is closest [K]."""
    samples: Array
    middle: Array
    """Mean positions of the samples [K,3]."""
    normal: Array
    """Outward normals [K,3]."""
    top: Array
    """Scalar product of position and normal [K]."""
    thick: Array
    """Thickness of the material below each face [K]; infinite in thick parts."""
    is_opposed: Mask
    """Whether each face of a thin part has an opposite face [K]."""


class _Near(NamedTuple):
    voxel: Array
    """Indices in the flattened grid [V]."""
    corner: Array
    """Indices along each axis [V,3]."""
    faces: Array
    """Index of the nearest face for each side [V,6]; -1: none."""
    is_own: Mask
    """Whether the nearest face lies in the voxel itself [V,6]."""
    main: Array
    """Face below which the voxel's material lies [V]."""

    def select(self, mask: Mask) -> _Near:
        return _Near(*(values[mask] for values in self))


def shortest_axes(gaussians: Gaussians) -> Array:
    """Return unit vectors along the shortest axes of flat Gaussians [N,3]; zero for others."""
    result = np.zeros((len(gaussians), 3), np.float32)
    for start in range(0, len(gaussians), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        order = np.argsort(gaussians.scales[part], axis=1)
        shortest, second = np.take_along_axis(gaussians.scales[part], order[:, :2], axis=1).T
        axes = rotation_matrices(gaussians.quats[part])
        axis = np.take_along_axis(axes, order[:, None, :1], axis=2)[:, :, 0]
        result[part] = np.where((shortest < FLAT * second)[:, None], axis, 0)
    return result


def find_surface(region: Mask, border: Mask, samples: Samples) -> Surface:
    """Find the material in the border voxels [X,Y,Z] of a region, from samples of the Gaussians."""
    stems, is_stem = find_stems(region, border, samples)
    border = border & ~is_stem
    faces = _find_faces(region, border, samples)
    near = _find_faces_around(faces, border)
    main = faces.normal[near.main]
    turned = np.abs(np.einsum("vsi,vi->vs", faces.normal[near.faces], main))
    is_slab = ((turned > PARALLEL) | (near.faces < 0)).all(axis=1)
    slabs = _make_slabs(faces, near.select(is_slab))
    edges = _cut_edges(faces, near.select(~is_slab))
    return Surface(((slabs, 1), (edges, PARTS), (stems, STEM_PARTS)))


def _find_faces(region: Mask, border: Mask, samples: Samples) -> _Faces:
    points, owner = samples.points, samples.owner
    voxel = np.asarray(np.ravel_multi_index(tuple(points.astype(np.int32).T), region.shape))
    centres = _centres_around(region, points, voxel)
    is_flat = np.asarray(samples.normals.any(axis=1))[owner]
    # In a voxel with flat Gaussians, only these determine the faces.
    flat_samples = np.bincount(voxel, is_flat, region.size)
    chosen = np.flatnonzero(border.ravel()[voxel] & (is_flat | (flat_samples[voxel] == 0)))
    points, voxel, is_flat, owner = points[chosen], voxel[chosen], is_flat[chosen], owner[chosen]
    normal, thickness, out = (
        samples.normals[owner],
        samples.thickness[owner],
        points - centres[voxel],
    )
    normal = np.where(is_flat[:, None], normal, _directions(voxel, out, region.size))
    normal *= np.where((out * normal).sum(axis=1) < 0, -1, 1)[:, None]
    axis = np.abs(normal).argmax(axis=1)
    side = 2 * axis + (normal[np.arange(len(normal)), axis] < 0)
    key, which, count = np.unique(6 * voxel + side, return_inverse=True, return_counts=True)
    middle, mean = _sums(which, points) / count[:, None], _normalise(_sums(which, normal))
    # Samples that are spread evenly from a to b have mean (a + b) / 2 and standard deviation
    # (b - a) / sqrt(12). Flat Gaussians lie at the surface, apart from noise.
    height = ((points - middle[which]) * mean[which]).sum(axis=1)
    noise = NOISE**2 * np.bincount(which, is_flat)
    reach = np.sqrt(3 * np.maximum(np.bincount(which, height**2) - noise, 0) / count)
    top = (middle * mean).sum(axis=1) + reach
    thick, none = np.full(len(key), np.inf), np.zeros(len(key), bool)
    faces = _Faces(key // 6, key % 6, count, middle, mean, top, thick, none)
    least = np.maximum(np.bincount(which, thickness) / count, 2 * reach)
    return _find_opposite_faces(region, faces, np.maximum(least, THINNEST))


def _directions(voxel: Array, out: Array, size: int) -> Array:
    """Return the outward normals of samples [S,3] from their positions `out` relative to the
    material around.

    The samples of a voxel have the same normal, unless the voxel has two outer sides.
    """
    sums = [np.bincount(voxel, column, size).astype(np.float32) for column in out.T]
    total = np.stack(sums, axis=1)[voxel]
    length = np.bincount(voxel, np.linalg.norm(out, axis=1), size)[voxel]
    is_single = np.linalg.norm(total, axis=1) > 0.5 * length
    normal = _normalise(np.where(is_single[:, None], total, out))
    normal[~normal.any(axis=1)] = UP
    return normal


def _centres_around(region: Mask, points: Array, voxel: Array) -> Array:
    """Return the centre of the material around each voxel [X*Y*Z,3]. Voxels without samples have
    the mean weight.
    """
    weight = np.bincount(voxel, minlength=region.size).astype(np.float64)
    empty = weight == 0
    weight[empty] = np.where(region.ravel()[empty], weight[~empty].mean(), 0)
    total = _blur(weight, region.shape)
    centres = np.empty((region.size, 3), np.float32)
    for axis, middle in enumerate(np.indices(region.shape, sparse=True)):
        moment = np.bincount(voxel, points[:, axis], region.size)
        place = np.broadcast_to(middle + 0.5, region.shape).ravel()
        moment[empty] = weight[empty] * place[empty]
        centres[:, axis] = _blur(moment, region.shape) / np.maximum(total, 1e-9)
    return centres


def _blur(values: Array, shape: tuple[int, ...]) -> Array:
    """Return the mean in the cube around each voxel [X*Y*Z]."""
    mean = scipy.ndimage.uniform_filter(values.reshape(shape), WINDOW, mode="constant")
    return mean.ravel()


def _find_opposite_faces(region: Mask, faces: _Faces, least: Array) -> _Faces:
    """Return the faces with thicknesses; a sheet without opposite faces has the thickness `least`
    [K].
    """
    thick, is_opposed = faces.thick.copy(), faces.is_opposed.copy()
    depths = np.arange(1, THICKEST + 2)
    inside = np.stack([_look_up(region, faces.middle - n * faces.normal) for n in depths])
    thin = np.flatnonzero(~inside.all(axis=0))
    if not len(thin):
        return faces
    count = min(NEIGHBOURS, len(thick))
    tree = scipy.spatial.KDTree(faces.middle)
    _, near = tree.query(faces.middle[thin], count, distance_upper_bound=THICKEST + TOGETHER)
    near = near.reshape(len(thin), count)
    missing = near == len(thick)
    near[missing] = 0
    normal = faces.normal[thin][:, None]
    arm = faces.middle[near] - faces.middle[thin][:, None]
    depth = faces.top[thin][:, None] - (faces.middle[near] * normal).sum(axis=2)
    aside = np.linalg.norm(arm - (arm * normal).sum(axis=2)[:, :, None] * normal, axis=2)
    turned = (faces.normal[near] * normal).sum(axis=2)
    fits = ~missing & (turned < -OPPOSITE) & (aside < ASIDE)
    depth = np.where(fits & (depth > 0) & (depth < THICKEST), depth, np.inf)
    nearest = depth < depth.min(axis=1, keepdims=True) + TOGETHER
    mean = _weighted_mean(np.where(nearest, depth, 0), faces.samples[near] * nearest)
    is_opposed[thin] = nearest.any(axis=1)
    is_sheet = is_opposed[thin] | ~inside[0, thin]
    excess = np.where(is_sheet, np.maximum(least[thin] - mean, 0), 0)
    thick[thin] = np.where(is_sheet, mean + excess, np.inf)
    top = faces.top.copy()
    top[thin] += excess / 2
    return faces._replace(top=top, thick=thick, is_opposed=is_opposed)


def _look_up(region: Mask, points: Array) -> Mask:
    at = np.clip(points.astype(np.int64), 0, np.array(region.shape) - 1)
    inside: Mask = region[tuple(at.T)]
    return inside


def _find_faces_around(faces: _Faces, border: Mask) -> _Near:
    """Return the faces near each voxel at a border.

    The main face is the face of the thinnest part. In thick parts, the main face is the face with
    the most samples in the voxel. If the voxel has no face, the main face is the nearest face.
    """
    table = np.full((border.size, 6), -1, np.int32)
    table[faces.voxel, faces.side] = np.arange(len(faces.voxel))
    voxel = np.flatnonzero(border)
    corner = np.stack(np.unravel_index(voxel, border.shape), axis=1)
    number = table[voxel].astype(np.int64)
    is_own = number >= 0
    away = np.where(is_own, -1, np.inf)
    for step in AROUND:
        other = table[np.ravel_multi_index(tuple((corner + step - 1).T), border.shape)]
        row, side = np.nonzero((other >= 0) & ~is_own)
        distance = np.linalg.norm(faces.middle[other[row, side]] - (corner[row] + 0.5), axis=1)
        nearer = distance < away[row, side]
        at = row[nearer], side[nearer]
        number[at], away[at] = other[at], distance[nearer]
    thick = faces.thick + np.where(faces.is_opposed, 0, THICKEST)
    thick = np.minimum(thick[number], 1e3) * np.where(is_own, PREFERRED, 1)
    worth = np.where(is_own, faces.samples[number], -away) - 1e6 * thick
    best = np.where(number < 0, -np.inf, worth).argmax(axis=1)
    main = number[np.arange(len(number)), best]
    return _Near(voxel, corner, number, is_own, main).select(main >= 0)


def _find_planes(faces: _Faces, near: _Near) -> tuple[Array, Array]:
    """Return the heights [V], [V] of the planes above and below the material at each main face."""
    normal, thick = faces.normal[near.main], faces.thick[near.main]
    turned = np.einsum("vsi,vi->vs", faces.normal[near.faces], normal)
    up, down = (turned > PARALLEL) & near.is_own, (turned < -PARALLEL) & near.is_own
    reach = faces.top - (faces.middle * faces.normal).sum(axis=1)
    height = np.einsum("vsi,vi->vs", faces.middle[near.faces], normal)
    height += np.sign(turned) * reach[near.faces]
    count = faces.samples[near.faces]
    bottom, has_bottom = _weighted_mean(height, count * down), down.any(axis=1)
    top = np.where(has_bottom & np.isfinite(thick), bottom + thick, faces.top[near.main])
    top = np.where(up.any(axis=1), _weighted_mean(height, count * up), top)
    return top, np.where(has_bottom & (bottom < top), bottom, top - thick)


def _make_slabs(faces: _Faces, near: _Near) -> Cubes:
    normal = faces.normal[near.main]
    planes = [height[:, None] for height in _find_planes(faces, near)]
    return _cubes(near.voxel, near.corner[:, None], np.ones((len(normal), 1)), normal, *planes)


def _cut_edges(faces: _Faces, near: _Near) -> Cubes:
    """Return the parts of voxels near which faces are not parallel.

    At convex edges, the material lies between the planes of the main face. At concave edges, the
    parts are filled evenly.
    """
    corner = parts_of(near.corner, PARTS)
    points = corner + 0.5 / PARTS
    upper, lower = (height[:, None] for height in _find_planes(faces, near))
    main = faces.normal[near.main]
    weight = np.ones(points.shape[:2])
    added = np.zeros(points.shape[:2])
    is_concave = np.zeros((len(points), 1), bool)
    for other in near.faces.T:
        normal, top = faces.normal[other], faces.top[other][:, None]
        used = (other >= 0) & (np.abs((normal * main).sum(axis=1)) < PARALLEL)
        arm = faces.middle[other] - faces.middle[near.main]
        above = (arm * (main - normal)).sum(axis=1) > BEYOND
        share = _share_below(points, normal, top)
        weight = np.where((used & ~above)[:, None], np.minimum(weight, share), weight)
        share -= _share_below(points, normal, top - faces.thick[other][:, None])
        added = np.where((used & above)[:, None], np.maximum(added, share), added)
        is_concave |= (used & above)[:, None]
    share = _share_below(points, main, upper) - _share_below(points, main, lower)
    weight = np.where(is_concave, np.maximum(np.minimum(weight, share), added), weight)
    upper, lower = np.where(is_concave, np.inf, upper), np.where(is_concave, -np.inf, lower)
    return _cubes(near.voxel, corner, weight, main, upper, lower)


def _share_below(points: Array, normal: Array, top: Array) -> Array:
    """Return the fractions [V,P] of the parts, with centres at `points` [V,P,3], below planes."""
    extent = np.abs(normal).sum(axis=1)[:, None] / PARTS
    return np.clip(0.5 + (top - np.einsum("vpi,vi->vp", points, normal)) / extent, 0, 1)


def _cubes(
    voxel: Array, corner: NDArray, weight: Array, normal: Array, upper: Array, lower: Array
) -> Cubes:
    """Return the P cubes of each of V voxels; planes have the heights `upper` and `lower` [V,1]."""
    parts = corner.shape[1]
    half = 0.5 / round(parts ** (1 / 3))
    level = np.einsum("vpi,vi->vp", corner + half, normal)
    # Planes at a distance of 1 are outside a cube.
    planes = [np.clip(height - level, -1, 1).ravel() for height in (upper, lower)]
    normals = np.repeat(normal, parts, axis=0)
    place = corner.reshape(-1, 3).astype(np.float64)
    return Cubes(np.repeat(voxel, parts), place, weight.ravel(), normals, *planes)


def _sums(which: Array, values: Array) -> Array:
    """Return the sums of the rows of `values` [S,3] in each group [K,3]."""
    return np.stack([np.bincount(which, column) for column in values.T], axis=1)


def _normalise(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    return unit


def _weighted_mean(values: Array, weights: NDArray) -> Array:
    """Return the weighted mean of each row [V]; zero if all weights of the row are zero."""
    mean: Array = (values * weights).sum(axis=1) / np.maximum(weights.sum(axis=1), 1)
    return mean
