"""Sums the work of a liquid's pressure on the bodies in the liquid.

The pressure of a step acts on a body as a force that is constant in all substeps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.work import make_node_work
from phy124.mpm import Model, State
from phy124.mpm.kept import Kept

if TYPE_CHECKING:
    from phy124.lattice.solver import LatticeSolver


class BodyWork(Kept):
    """Work of the liquid on bodies of particles, summed once `start` is called."""

    kept = ("total",)

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._state = model, state
        self.numbers = [body for body in range(model.bodies) if body not in model.wet]
        self._runs = [model.particles(body) for body in self.numbers]
        self.on = False
        self.total = np.zeros(len(self._runs))
        """Work of the liquid on each body since the start [B], J."""

    def start(self) -> None:
        """Sum the work from the next step on."""
        self.on = True

    def begin(self) -> None:
        """Store the positions of the bodies' particles at the start of the substeps."""
        if self.on:
            self._before = [self._read(array) for array in (self._state.x, self._state.C)]

    def end(self, pushes: wp.array, turns: wp.array, drift: float) -> None:
        """Add the work of the liquid in the substeps since `begin`.

        Args:
            pushes: Acceleration of each particle by the pressure [P,3], m/s^2.
            turns: Rate of change of each particle's C by the pressure [P,3,3], 1/s^2.
            drift: Duration of the substeps [s].
        """
        if not self.on:
            return
        (x, C), state, mass = self._before, self._state, self._read(self._model.mass)
        way, strain = self._read(state.x) - x, drift / 2 * (C + self._read(state.C))
        done = (self._read(pushes) * way).sum(axis=1)
        # The inertia of a particle's C is a quarter of dx^2 times the mass.
        done += self._model.dx**2 / 4 * (self._read(turns) * strain).sum(axis=(1, 2))
        self.total += [mass[run] @ done[run] for run in self._runs]

    def _read(self, array: wp.array) -> NDArray[np.float64]:
        return np.array(array.numpy(), np.float64)


class LatticeBodyWork(BodyWork):
    """Work of the liquid on bodies on lattices."""

    def __init__(self, solver: LatticeSolver) -> None:
        super().__init__(solver.model, solver.state)
        self._solver, device = solver, solver.model.device
        self._ends = np.searchsorted(solver.lattice.body, range(solver.model.bodies + 1))
        self._u = wp.zeros_like(solver.nodes_state.u)
        self._twice = wp.array([2.0, 0.0, 0.0], dtype=solver.model.real, device=device)
        self._done = wp.zeros((solver.model.bodies, 2), dtype=wp.float64, device=device)

    def begin(self) -> None:
        """Store the negated displacements of the nodes at the start of the substeps."""
        if self.on:
            self._u.assign(-self._solver.nodes_state.u.numpy())

    def end(self, pushes: wp.array, turns: wp.array, drift: float) -> None:
        """Add the work of the liquid in the substeps since `begin`, from the forces that the
        lattices store.
        """
        if not self.on:
            return
        crew, nodes, kernel = self._solver.crew, self._solver.nodes_state, make_node_work
        self._done.zero_()
        for body, (first, last) in enumerate(zip(self._ends, self._ends[1:], strict=False)):
            inputs: list[Any] = [int(first), 0, nodes.inverse, *crew.lasting_forces(), self._twice]
            inputs += [crew.no_pull, self._u, nodes.u]
            row = self._done[body]
            wp.launch(
                kernel(self._model.real), int(last - first), inputs=inputs, outputs=[row],
                device=self._model.device,
            )  # fmt: skip
        self.total += np.asarray(self._done.numpy())[:, 0]
