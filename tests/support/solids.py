"""Solids of large voxels, which are found quickly, and boxes of flat Gaussians on their surface."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, quaternions
from phy124.particles import solid

COARSE: dict[bytes, Any] = {}
"""The solids of `coarse`, as phy124.particles.solid keeps its own."""


@contextmanager
def coarse() -> Iterator[None]:
    """Find solids of an eighth of the voxels, which takes an eighth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solid, "ACROSS", solid.ACROSS // 2)
        patch.setattr(solid, "_kept", COARSE)
        yield


def frame(turn: tuple[float, float]) -> NDArray[np.float64]:
    """Return the directions along a plate, of its width and across it, as columns [3,3].

    Args:
        turn: Rotations about the plate's width and about its length [degrees].
    """
    a, b = np.radians(turn)
    pitch = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    roll = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return pitch @ roll


def box_of_discs(
    sides: NDArray, axes: NDArray, middle: NDArray, apart: float, *, faces: range = range(6)
) -> Gaussians:
    """Return flat Gaussians on the faces of a box.

    Args:
        sides: Lengths of the sides [3], m.
        axes: Directions of the sides, as columns [3,3].
        middle: Middle of the box [3], m.
        apart: Distance of the Gaussians [m]; their places are random within a tenth of it.
        faces: Numbers of the faces that have Gaussians.
    """
    rng, half = np.random.default_rng(0), np.asarray(sides) / 2
    means, quats = [], []
    for axis, side in np.array(list(itertools.product(range(3), (-1, 1))))[list(faces)]:
        others = [(axis + 1) % 3, (axis + 2) % 3]
        lines = []
        for other in others:
            count = max(1, round(2 * half[other] / apart))
            lines.append((2 * (np.arange(count) + 0.5) / count - 1) * half[other])
        x = np.zeros((len(lines[0]) * len(lines[1]), 3))
        x[:, others] = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
        x[:, others] += rng.uniform(-0.1, 0.1, (len(x), 2)) * apart
        x[:, axis] = side * half[axis]
        means.append(middle + x @ axes.T)
        quats.append(np.tile(quaternions(axes[:, [*others, axis]][None]), (len(x), 1)))
    count = sum(map(len, means))
    scales = np.tile(np.array([0.6, 0.6, 0.02]) * apart, (count, 1))
    sh = np.zeros((count, 1, 3))
    opacities = np.full(count, 0.9)
    return Gaussians(np.concatenate(means), np.concatenate(quats), scales, opacities, sh)


STEM = np.array([0.3, 0.4, 0.0])
"""Start of the axis of `stem_of_discs` [sixty-fourths of a metre]."""


def stem_of_discs(
    radius: float, along: tuple[float, float, float], *, noise: float = 0.12, tilt: float = 0.25
) -> Gaussians:
    """Return long discs on a round stem, with random places and opacities.

    Args:
        radius: Radius of the stem [sixty-fourths of a metre]; its length is 62 of these.
        along: Direction of the stem.
        noise: Standard deviation of the discs' distances from the axis [sixty-fourths of a metre].
        tilt: Standard deviation of each component of the discs' normals.
    """
    rng, count = np.random.default_rng(0), 4000
    axis = np.array(along) / np.linalg.norm(along)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    angle, place = rng.uniform(0, 2 * np.pi, (count, 1)), rng.uniform(0, 62, (count, 1))
    out = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    away = np.maximum(radius + noise * rng.normal(size=(count, 1)), 0)
    normal = out + tilt * rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, axis)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    quats = quaternions(np.stack([np.cross(across, normal), across, normal], axis=2))
    scales = rng.uniform(0.6, 1.4, (count, 1)) * [0.5, 0.14, 0.03]
    means = STEM + place * axis + away * out
    opacities, sh = rng.uniform(0.1, 0.9, count), np.zeros((count, 1, 3))
    return Gaussians(means / 64, quats, scales / 64, opacities, sh)
