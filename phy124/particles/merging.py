"""Merges neighbouring Gaussians to make files smaller.

A new Gaussian has the joint mean, covariance and colour of two Gaussians, weighted by mass (opacity
times volume). If its opacity would exceed `OPAQUE`, the new Gaussian is enlarged instead.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions
from phy124.io.clip import Clip

COLOUR = 0.1
"""Distance, relative to the object's size, that counts as much as a colour difference of 1."""
NEIGHBOURS = 6
"""Number of nearest neighbours among which a partner is searched."""
OPAQUE = 0.99
SAMPLES = 5
"""Number of frames in which the Gaussians of a clip are compared."""


def group_neighbours(
    places: NDArray, count: int, object_id: NDArray | None = None
) -> NDArray[np.int64]:
    """Assign each point [N,D] to one of `count` groups [N] by merging pairs of neighbours.

    Points of different objects (`object_id` [N]) are not merged. `count` must be at least the
    number of objects.
    """
    kind = np.zeros(len(places), np.int64) if object_id is None else object_id
    # the last column separates the objects by more than their size
    apart = 1 + 2 * float(np.linalg.norm(np.ptp(places, axis=0)))
    places = np.column_stack([places, apart * kind])
    label = np.arange(len(places))
    while len(places) > count:
        near, other = scipy.spatial.KDTree(places).query(
            places, k=min(NEIGHBOURS, len(places)), workers=-1
        )
        first, distance = np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()
        second = other.ravel()
        same = kind[first] == kind[second]
        pairs = np.flatnonzero(same & (first < second))
        if not len(pairs):
            pairs = np.flatnonzero(same & (first != second))
        joined, left = np.arange(len(places)), len(places) - count
        free = np.ones(len(places), bool)
        for pair in pairs[np.argsort(distance[pairs], kind="stable")]:
            a, b = first[pair], second[pair]
            if left and free[a] and free[b]:
                free[a] = free[b] = False
                joined[b] = a
                left -= 1
        _, number = np.unique(joined, return_inverse=True)
        sizes = np.bincount(label)
        weights = np.bincount(number, sizes)
        places = np.stack(
            [np.bincount(number, sizes * column) / weights for column in places.T], axis=1
        )
        kind = kind[np.unique(number, return_index=True)[1]]
        label = number[label]
    return label


def merge_groups(
    gaussians: Gaussians, group: NDArray[np.int64], opacities: NDArray | None = None
) -> Gaussians:
    """Merge the Gaussians of each of G groups; `group` [N] has the index of each Gaussian's group.

    The members of a group belong to the same object. Mass, mean and colour are kept. With
    prescribed `opacities` [G], sizes are adapted to preserve the mass. Otherwise the covariance is
    also kept, unless the opacity would exceed `OPAQUE`.
    """
    volume = gaussians.scales.astype(np.float64).prod(axis=1)
    mass = np.maximum(gaussians.opacities * volume, 1e-300)
    total = np.bincount(group, mass)

    def mean(values: NDArray) -> NDArray[Any]:
        flat = values.reshape(len(values), -1).astype(np.float64)
        columns = [np.bincount(group, mass * column) / total for column in flat.T]
        return np.stack(columns, axis=1).reshape(len(total), *values.shape[1:])

    means = mean(gaussians.means)
    away = gaussians.means - means[group]
    spread = mean(gaussians.covariances() + away[:, :, None] * away[:, None, :])
    lengths, axes = np.linalg.eigh(spread)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    scales = np.sqrt(np.maximum(lengths, 1e-24))
    opacity = total / scales.prod(axis=1)
    shown = np.minimum(opacity, OPAQUE) if opacities is None else opacities
    scales *= (opacity / np.maximum(shown, 1e-12))[:, None] ** (1 / 3)
    alone = np.bincount(group) == 1
    quats = quaternions(axes).astype(np.float32)
    same = np.zeros(len(total), np.int64)
    same[group] = np.arange(len(group))
    object_id = None if gaussians.object_id is None else gaussians.object_id[same]
    result = Gaussians(means, quats, scales, shown, mean(gaussians.sh), object_id)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        getattr(result, name)[alone] = getattr(gaussians, name)[same[alone]]
    return result


def merge_to(gaussians: Gaussians, count: int) -> Gaussians:
    """Merge Gaussians of the same object until at most `count` are left.

    Raises:
        InputError: If `count` is below the number of objects.
    """
    check_count(count, gaussians.object_id)
    if len(gaussians) <= count:
        return gaussians
    points = _feature_points([gaussians.means], gaussians.rgb)
    return merge_groups(gaussians, group_neighbours(points, count, gaussians.object_id))


def merge_clip_to(clip: Clip, count: int) -> Clip:
    """Merge the Gaussians of a clip that stay together; only colours of degree 0 are kept.

    Raises:
        InputError: If `count` is below the number of objects.
    """
    check_count(count, clip.object_id)
    if clip.means.shape[1] <= count:
        return clip
    chosen = np.unique(np.linspace(0, len(clip) - 1, SAMPLES).astype(int))
    first = clip.frame(0).gaussians
    points = _feature_points([clip.means[index] for index in chosen], first.rgb)
    group = group_neighbours(points, count, clip.object_id)
    opacities = merge_groups(first, group).opacities
    frames = []
    for frame in replace(clip, rotations=None, sh=clip.sh[:, :1]).frames():
        joined = merge_groups(frame.gaussians, group, opacities)
        frames.append(replace(frame, gaussians=joined, velocities=None, contacts=None))
    report = {**clip.report, "gaussians": len(opacities), "grains": 0}
    report |= {"shine": {}, "liquids": [], "matte": [], "dents": [], "fragments": []}
    return replace(Clip.from_frames(frames), scene=clip.scene, report=report)


def check_count(count: int, object_id: NDArray | None) -> None:
    """Raise an error if an object would have no Gaussians left; `object_id` is [N] or None.

    Raises:
        InputError: If the number is below the number of objects.
    """
    objects = 1 if object_id is None else len(np.unique(object_id))
    if count < objects:
        limit = "at least one of its objects would have no Gaussians left."
        raise InputError("merge", count, limit, f"Choose at least {objects}.")


def _feature_points(means: list[NDArray], rgb: NDArray) -> NDArray:
    """Return a point [N,3T+3] for each Gaussian. Points are close if their Gaussians have similar
    colours and are close in all T frames.
    """
    size = max(float(np.ptp(means[0], axis=0).max()), 1e-12)
    return np.concatenate([*(x / size / len(means) ** 0.5 for x in means), COLOUR * rgb], axis=1)
