"""Synthetic captures of a small scene with floaters, in any unit and orientation."""

from typing import NamedTuple

import numpy as np

from phy124.gaussians import Gaussians, join, rotation_matrices
from phy124.io.axes import orientation, rotate_gaussians
from support.shapes import ball


class Place(NamedTuple):
    """A synthetic capture, with its true values."""

    gaussians: Gaussians
    """Gaussians of the ball, then of the floor, then floaters; they are written by `write_ply`."""
    kind: np.ndarray
    """0 ball, 1 floor, 2 floater [N]."""
    up: np.ndarray
    """Up direction in the axes of the file that `write_ply` writes [3]."""
    rotation: np.ndarray
    """Rotation from the axes of the upright place to those of the file [3,3]."""
    scale: float
    """File units per metre of the upright place, where the ball measures 1 m."""
    offset: np.ndarray
    """Position, in the file, of the place's origin, which is on the floor under the ball."""

    def in_file(self, points) -> np.ndarray:
        """Convert points of the upright scene [N,3] to the file's axes and units."""
        return self.scale * np.atleast_2d(points) @ self.rotation.T + self.offset


def captured(seed: int, *, floor: int = 6000, floaters: int = 80, noise: float = 0.004) -> Place:
    """Return a capture of a ball of 1 m on a chequered floor of 4 m."""
    rng = np.random.default_rng(seed)
    turn = rotation_matrices(rng.normal(size=(1, 4)))[0]
    scale, shift = float(np.exp(rng.uniform(-3, 3))), rng.normal(size=3) * 5
    # The part of the ball at the floor is not visible.
    shell = ball(3000).transform(1.0, np.array([0, 0, 0.5]))
    shell = shell.select(shell.means[:, 2] > 0.02)
    upright = join([shell, _floor(rng, floor, noise), _floaters(rng, floaters)])
    kind = np.repeat([0, 1, 2], [len(shell), floor, floaters])
    to_file = orientation().T  # the rotation that write_ply applies
    return Place(
        rotate_gaussians(upright, turn).transform(scale, shift),
        kind,
        to_file @ turn @ [0, 0, 1],
        to_file @ turn,
        scale,
        to_file @ shift,
    )


def _floor(rng, count: int, noise: float) -> Gaussians:
    x, y = rng.uniform(-2, 2, (2, count))
    bright = ((np.floor(x * 2) + np.floor(y * 2)) % 2)[:, None]
    means = np.stack([x, y, noise * rng.normal(size=count)], axis=1)
    scales = np.tile([0.04, 0.04, 0.003], (count, 1))
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    return Gaussians.from_rgb(
        means, quats, scales, np.full(count, 0.95), 0.3 + 0.4 * np.repeat(bright, 3, axis=1)
    )


def _floaters(rng, count: int) -> Gaussians:
    means = rng.uniform([-3, -3, -1], [3, 3, 4], (count, 3))
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    scales = np.exp(rng.uniform(-4, -2, (count, 3)))
    return Gaussians.from_rgb(
        means, quats, scales, rng.uniform(0.05, 0.6, count), rng.random((count, 3))
    )
