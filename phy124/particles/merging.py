"""Merges neighbouring Gaussians to make files smaller.

Two Gaussians are replaced by one Gaussian with their joint mean, covariance and colour, weighted by
mass (opacity times volume). The opacity of the new Gaussian preserves the mass. If this opacity
would exceed `OPAQUE`, the new Gaussian is enlarged instead.
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
"""Distance that counts as much as a colour difference of 1 when Gaussians are grouped, relative to
the object's size.
"""
NEIGHBOURS = 6
"""Number of nearest neighbours among which a partner is searched for each Gaussian."""
OPAQUE = 0.99
"""Largest opacity of a merged Gaussian."""
SAMPLES = 5
"""Number of frames in which the Gaussians of a clip are compared before they are grouped."""


def group_neighbours(places: NDArray, count: int) -> NDArray[np.int64]:
    """Assign each point [N,D] to one of `count` groups [N] by repeatedly merging pairs of
    neighbours.
    """
    label = np.arange(len(places))
    while len(places) > count:
        near, other = scipy.spatial.KDTree(places).query(
            places, k=min(NEIGHBOURS, len(places)), workers=-1
        )
        first, distance = np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()
        second = other.ravel()
        pairs = np.flatnonzero(first < second)
        if not len(pairs):
            pairs = np.flatnonzero(first != second)
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
        label = number[label]
    return label


def merge_groups(
    gaussians: Gaussians, group: NDArray[np.int64], opacities: NDArray | None = None
) -> Gaussians:
    """Merge each of G groups into one Gaussian with the group's mass, mean and colour.

    Args:
        gaussians: N Gaussians.
        group: Index of the group of each Gaussian [N].
        opacities: Prescribed opacities [G]; the sizes are then adapted to preserve the mass. None:
            opacities that preserve mass and covariance, up to the limit `OPAQUE`.
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
    result = Gaussians(means, quats, scales, shown, mean(gaussians.sh))
    same = np.zeros(len(total), np.int64)
    same[group] = np.arange(len(group))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        getattr(result, name)[alone] = getattr(gaussians, name)[same[alone]]
    return result


def merge_to(gaussians: Gaussians, count: int) -> Gaussians:
    """Merge Gaussians until at most `count` are left.

    Args:
        gaussians: The Gaussians.
        count: Largest number of Gaussians in the result.

    Raises:
        InputError: If `count` is below 1.
    """
    check_not_empty(count)
    if len(gaussians) <= count:
        return gaussians
    return merge_groups(
        gaussians, group_neighbours(_feature_points([gaussians.means], gaussians.rgb), count)
    )


def merge_clip_to(clip: Clip, count: int) -> Clip:
    """Merge the Gaussians of a clip that stay together; only colours of degree 0 are kept.

    Args:
        clip: The clip.
        count: Largest number of Gaussians in the result.

    Raises:
        InputError: If `count` is below 1.
    """
    check_not_empty(count)
    if clip.means.shape[1] <= count:
        return clip
    chosen = np.unique(np.linspace(0, len(clip) - 1, SAMPLES).astype(int))
    first = clip.frame(0).gaussians
    group = group_neighbours(
        _feature_points([clip.means[index] for index in chosen], first.rgb), count
    )
    opacities = merge_groups(first, group).opacities
    frames = []
    for frame in replace(clip, rotations=None, sh=clip.sh[:, :1]).frames():
        joined = merge_groups(frame.gaussians, group, opacities)
        frames.append(replace(frame, gaussians=joined, velocities=None, contacts=None))
    report = {**clip.report, "gaussians": len(opacities), "grains": 0}
    report |= {"shine": {}, "liquids": [], "matte": [], "dents": [], "fragments": []}
    return replace(Clip.from_frames(frames), scene=clip.scene, report=report)


def check_not_empty(count: int) -> None:
    """Check that a number of Gaussians is at least 1.

    Raises:
        InputError: If the number is below 1.
    """
    if count < 1:
        raise InputError("merge", count, "no Gaussians would be left.", "Choose at least 1.")


def _feature_points(means: list[NDArray], rgb: NDArray) -> NDArray:
    """Return a point [N,3T+3] for each Gaussian. Two points are close if their Gaussians have
    similar colours and are close in all T frames.
    """
    size = max(float(np.ptp(means[0], axis=0).max()), 1e-12)
    return np.concatenate([*(x / size / len(means) ** 0.5 for x in means), COLOUR * rgb], axis=1)
