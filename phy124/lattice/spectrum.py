"""Spectrum: the largest angular frequency of the body, which limits the substep.

At rest, the frequency is found by power iteration. In motion its square grows at most as the
stiffness of the node that stiffens most. Where single nodes are squeezed, this bound is far too
large; then a few more iterations, from the last shape and from a motion of the squeezed nodes,
follow the largest frequency in the current state.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.lattice.rest import RestLattice
from phy124.lattice.walls import Nodes
from phy124.lattice.workers import Crew
from phy124.mpm.model import Model

ROUNDS, FEW, PROBE = 60, 4, 1e-3
"""Power iterations at rest and in motion, and size of their displacements [cells]."""
CALM = 1.3
"""Growth of the stiffness up to which the bound is used."""
NOISE = 0.1
"""Size of the motion of squeezed nodes with which iterations start, relative to the last shape."""
EVERY, CHANGED = 32, 2.0
"""Number of substeps, and growth of the bound, after which the frequency is followed again."""
MISSED = 1.2
"""Factor on the squared frequency for what few iterations miss."""


class Spectrum:
    """The largest angular frequency of a body."""

    def __init__(self, model: Model, crew: Crew, nodes: Nodes, lattice: RestLattice) -> None:
        """Measure the body at rest.

        Args:
            model: The constants of the run.
            crew: Computes forces, and measures the stiffness of nodes.
            nodes: The nodes, at rest.
            lattice: The lattice at rest.
        """
        self._model, self._crew, self._nodes, self._lattice = model, crew, nodes, lattice
        self._carried = lattice.ties.T.tocsr()
        free = lattice.mass > 0
        self._inverse = np.divide(1, lattice.mass, out=np.zeros(len(free)), where=free)[:, None]
        self._free = free
        self._shape: NDArray[Any] = np.random.default_rng(0).normal(size=(len(free), 3))
        self._at_rest = crew.stiffness()
        self.fastest = math.sqrt(self._iterate(ROUNDS))
        """Largest angular frequency at rest [1/s]."""
        ratios = [section.sound_speed() ** 2 * section.density for section in model.materials]
        viscous = [section.viscous_limit(model.dx) for section in model.materials]
        eta = [
            m.density * model.dx**2 / (8 * v) for m, v in zip(model.materials, viscous, strict=True)
        ]
        self._delay = max(a / b for a, b in zip(eta, ratios, strict=True))
        """Largest ratio of viscosity to stiffness [s]."""

        self._relief, self._worst, self._counted = 1.0, 1.0, 0
        """Ratio of the followed frequency's square to its bound, growth of the stiffest node, and
        number of substeps, when the frequency was last followed.
        """

    def stiffness(self, substeps: int) -> float:
        """Return dx^2 / dt^2 [m^2/s^2] of the longest stable substep, as last measured.

        Args:
            substeps: Number of substeps so far, from which the iterations take random numbers.
        """
        growth = self._crew.stiffness() / self._at_rest
        worst, cell = float(growth.max()), self._model.dx / 2
        bound = (self.fastest * cell) ** 2 * worst
        if worst <= CALM:
            return bound
        if substeps - self._counted < EVERY and worst < CHANGED * self._worst:
            return self._relief * bound
        noise = np.zeros_like(self._shape)
        noise[self._free] = (growth / worst)[:, None]
        noise *= np.random.default_rng(substeps).normal(size=noise.shape)
        size = np.abs(self._shape).max()
        self._shape = self._shape + NOISE * size * noise
        square = MISSED * self._iterate(FEW)
        z = math.sqrt(square) * self._delay
        shorter = math.sqrt(1 + z * z) - z
        self._relief = min(1.0, square * cell**2 / shorter**2 / bound)
        self._worst, self._counted = worst, substeps
        return self._relief * bound

    def _iterate(self, rounds: int) -> float:
        """Return the square of the largest frequency [1/s^2] after some power iterations."""
        nodes, ties, tied = self._nodes, self._lattice.ties, self._lattice.tied
        carried = self._carried
        u, v = nodes.u.numpy().copy(), nodes.v.numpy().copy()
        nodes.v.zero_()  # Viscous forces must not contribute.
        before, square, size = self._crew.forces(), 0.0, PROBE * self._model.dx
        shape = self._shape
        for _ in range(rounds):
            shape[tied] = ties @ shape
            shape /= np.abs(shape).max()
            nodes.u.assign(u + size * shape)
            force = (before - self._crew.forces()) / size
            force += carried @ force[tied]
            faster = self._inverse * force
            square = float(np.linalg.norm(faster) / np.linalg.norm(shape[self._free]))
            shape = faster
        nodes.u.assign(u)
        nodes.v.assign(v)
        self._shape = shape / np.abs(shape).max()
        return square

    def snapshot(self) -> dict[str, Any]:
        """Return the last shape."""
        numbers = [self._relief, self._worst, self._counted]
        return {"shape": self._shape.copy(), "numbers": numbers}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self._shape = np.array(snapshot["shape"])
        self._relief, self._worst, self._counted = snapshot["numbers"]
