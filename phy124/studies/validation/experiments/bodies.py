"""Particles of the bodies that are experimented on, and walls that make a problem plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.gaussians import spread_directions
from phy124.mpm import Solver

Array = NDArray[np.float64]
FAR = 1e3
"""Beyond every body [m]: behind such a plane all nodes are inside the wall."""


def brick(counts: Sequence[int], spacing: float, corner: Sequence[float] = (0, 0, 0)) -> Array:
    """Particles [P,3], m, in the middles of cubes that fill a box from its corner on.

    Args:
        counts: Particles along each axis; 1 along y makes a sheet in the plane y = corner.
        spacing: Edge of the cubes [m].
        corner: Lowest corner of the box [m].
    """
    lines = [(np.arange(n) + 0.5) * spacing for n in counts]
    if counts[1] == 1:
        lines[1] = np.zeros(1)
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(x + np.array(corner), float)


def plane() -> HalfSpace:
    """A wall in which everything is: nothing moves along y, so that a sheet is a whole body."""
    return HalfSpace(point=(0, FAR, 0), normal=(0, 1.0, 0), contact="slip")


def mirrors(*axes: int) -> list[HalfSpace]:
    """Planes of symmetry through the origin across the axes, beyond which the body is."""
    return [HalfSpace(normal=tuple(np.eye(3)[axis].tolist()), contact="slip") for axis in axes]


def shells(radius: float, spacing: float) -> tuple[Array, Array]:
    """Particles of a ball in shells, so that its surface is smooth, and their volumes.

    Args:
        radius: Of the ball [m].
        spacing: About the distance of neighbours [m].
    """
    count, rng = round(radius / spacing), np.random.default_rng(0)
    step, x, volume = radius / count, [], []
    for k in range(count):
        middle = (k + 0.5) * step
        many = max(4, round(4 * np.pi * (middle / step) ** 2))
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        x.append(middle * spread_directions(many) @ turn)
        shell = 4 / 3 * np.pi * ((k + 1) ** 3 - k**3) * step**3
        volume.append(np.full(many, shell / many))
    return np.concatenate(x), np.concatenate(volume)


def connected_end(solver: Solver) -> float:
    """How far along x the body reaches [m]: up to the first gap wider than a cell."""
    x = np.sort(solver.state.x.numpy()[:, 0].astype(float))
    gaps = np.flatnonzero(np.diff(x) > solver.model.dx)
    return float(x[gaps[0]] if len(gaps) else x[-1])


def mean_along(solver: Solver, of: str, axis: Sequence[float]) -> float:
    """Mass average of a vector of the state, `x` or `v`, along an axis."""
    mass = solver.model.mass.numpy().astype(float)
    values = getattr(solver.state, of).numpy().astype(float) @ np.array(axis, float)
    return float(mass @ values / mass.sum())
