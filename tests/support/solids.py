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
