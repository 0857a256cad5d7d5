"""Plane and symmetric problems: walls that make them so, and averages over the body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.mpm import Solver
from phy124.studies.validation.bodies import lattice

Array = NDArray[np.float64]
FAR = 1e3
"""Beyond every body [m]: behind such a plane all nodes are inside the wall."""


def sheet(counts: Sequence[int], spacing: float, corner: Sequence[float] = (0, 0, 0)) -> Array:
    """Return particles [P,3], m, of one layer of a lattice, in the plane y = corner.

    Args:
        counts: Particles along x and z [2].
        spacing: Their distance [m].
        corner: Lowest corner of the sheet [m].
    """
    x = lattice((counts[0], 1, counts[1]), spacing) * [1.0, 0.0, 1.0]
    return np.asarray(x + np.asarray(corner), float)


def plane() -> HalfSpace:
    """A wall in which everything is: nothing moves along y, so that a sheet is a whole body."""
    return HalfSpace(point=(0, FAR, 0), normal=(0, 1.0, 0), contact="slip")


def mirrors(*axes: int) -> list[HalfSpace]:
    """Planes of symmetry through the origin across the axes, beyond which the body is."""
    return [HalfSpace(normal=tuple(np.eye(3)[axis].tolist()), contact="slip") for axis in axes]


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
