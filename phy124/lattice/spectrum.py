"""Spectrum: the largest angular frequency of the body, which limits the substep.

At rest, the frequency is found by power iteration. In motion, every few substeps, one more
iteration starts from the last shape and the current accelerations. The accelerations lead the
iteration to parts of the body that have just been squeezed, or whose vibration begins to grow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.lattice.rest import RestLattice
from phy124.lattice.walls import Nodes
from phy124.lattice.workers import Crew
from phy124.mpm.model import Model

ROUNDS, TRIAL = 60, 1e-3
"""Power iterations at rest, and size of trial displacements [cells]."""
MIXED = 0.1
"""Size of the accelerations with which an iteration starts, relative to the last shape."""
MISSED = 1.1
"""Factor on the squared frequency for what the iterations miss."""


class Spectrum:
    """The largest angular frequency of a body."""

    def __init__(
        self,
        model: Model,
        crew: Crew,
        nodes: Nodes,
        lattice: RestLattice,
        run_trials: Callable[[], None],
    ) -> None:
        """Measure the body at rest.

        Args:
            model: The constants of the run.
            crew: Computes accelerations of nodes.
            nodes: The nodes, at rest.
            lattice: The lattice at rest.
            run_trials: Runs the trials of all workers.
        """
        self._model, self._crew, self._nodes, self._lattice = model, crew, nodes, lattice
        self._run_trials = run_trials
        self._shape: NDArray[Any] = np.random.default_rng(0).normal(size=(len(lattice), 3))
        self._shape[lattice.tied] = 0
        v = nodes.v.numpy().copy()
        nodes.v.zero_()  # Viscous forces must not contribute.
        run_trials()
        self._least = self._iterate(crew.accelerations(trial=True), ROUNDS)
        nodes.v.assign(v)
        self.square = self._least
        """Square of the largest angular frequency, as last measured [1/s^2]."""
        ratios = [section.sound_speed() ** 2 * section.density for section in model.materials]
        viscous = [section.viscous_limit(model.dx) for section in model.materials]
        eta = [
            m.density * model.dx**2 / (8 * v) for m, v in zip(model.materials, viscous, strict=True)
        ]
        self._delay = max(a / b for a, b in zip(eta, ratios, strict=True))
        """Largest ratio of viscosity to stiffness [s]."""

    @property
    def stiffness(self) -> float:
        """dx^2 / dt^2 [m^2/s^2] of the longest stable substep, as last measured."""
        z = math.sqrt(self.square) * self._delay
        shorter = math.sqrt(1 + z * z) - z
        return self.square * (self._model.dx / 2 / shorter) ** 2

    def follow(self) -> None:
        """Measure the current state, in which the forces of all points have been summed."""
        a = self._crew.accelerations()
        largest = np.abs(a).max()
        if largest > 0:
            self._shape += MIXED / largest * a
        self.square = max(self._least, MISSED * self._iterate(a, 1))

    def _iterate(self, before: NDArray[Any], rounds: int) -> float:
        """Return the square of the largest frequency [1/s^2] after some power iterations.

        The norm weighs the largest motions most, so that it measures the fastest vibration, which
        moves few nodes, although the shape also has small motions of all nodes.

        Args:
            before: Accelerations of the nodes without trial displacements [N,3], m/s^2.
            rounds: Number of iterations.
        """
        nodes, ties, tied = self._nodes, self._lattice.ties, self._lattice.tied
        u, square, size = nodes.u.numpy().copy(), 0.0, TRIAL * self._model.dx
        for _ in range(rounds):
            shape = self._shape / np.abs(self._shape).max()
            length = _norm(shape)
            shape[tied] = ties @ shape
            nodes.u.assign(u + size * shape)
            self._run_trials()
            self._shape = (before - self._crew.accelerations(trial=True)) / size
            square = _norm(self._shape) / length
        nodes.u.assign(u)
        self._shape /= np.abs(self._shape).max()
        return square

    def snapshot(self) -> dict[str, Any]:
        """Return the last shape and frequency."""
        return {"shape": self._shape.copy(), "square": self.square}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self._shape, self.square = np.array(snapshot["shape"]), snapshot["square"]


def _norm(values: NDArray[Any]) -> float:
    """Return the fourth root of the sum of the fourth powers, of a largest value near 1."""
    squares = values * values
    return float(np.vdot(squares, squares)) ** 0.25
