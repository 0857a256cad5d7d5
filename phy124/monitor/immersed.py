"""Observers of runs with bodies on lattices in a liquid with projected pressure."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.contact import MOMENT
from phy124.kernels.work import WORK
from phy124.monitor.coupled import CoupledPairs, elastic_names
from phy124.monitor.external_work import MEAN_PUSH, PUSH, ROOM, MeanWork
from phy124.monitor.lattice import LatticeWrenches
from phy124.monitor.observer import Effect, Observer, Subject
from phy124.monitor.pool_work import PoolWork
from phy124.scene import Scene

BODIES = MEAN_PUSH
"""Cause: walls that act on lattices. Forces on points of lattices are counted under `PUSH`."""


class ImmersedWork(PoolWork, MeanWork):
    """External impulse and work on lattices and liquid, from the solver's sums."""

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which sums the impulses of walls."""
        self._solver = self._liquid = solver
        counts = [len(each.workers) for each in (solver.lattice, solver.liquid)]
        sums = wp.zeros((sum(counts), ROOM), dtype=wp.float64, device=solver.model.device)
        self._device[PUSH] = sums
        solver.keep_pushes(sums[: counts[0]], sums[counts[0] :])
        self._read_impulses()
        self.follow_steps(solver)

    def change(self, scene: Scene) -> None:
        """Keep the impulses of the previous walls, and sum the impulses of the new walls."""
        self._closed[BODIES] = self._closed[BODIES] + self._open(BODIES)
        self._read_impulses()

    def _read_impulses(self) -> None:
        self._device[BODIES] = self._solver.walls.sums
        super()._read_impulses()
        self._solver.record()

    def of_walls(self) -> float:
        """Return the work of all walls [J]; negative for walls at rest."""
        return super().of_walls() + float(self._sum(BODIES)[WORK])


class ImmersedWrenches(LatticeWrenches):
    """Wrenches (forces and torques) on walls, from the impulses on lattices and liquid."""

    def _now(self) -> NDArray[np.float64]:
        rows, impulses = super()._now(), self._solver.impulses
        for row, name in zip(rows, self._names, strict=True):
            if name in impulses.names:
                impulse, moment = np.split(impulses.wrench(name).numpy(), 2)
                row[:3] += impulse
                row[MOMENT : MOMENT + 3] += moment
        return rows


class ImmersedPairs(CoupledPairs):
    """Adds the bodies on lattices to the report's list of effects."""

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        scene = subject.scene
        bodies, solver = ", ".join(elastic_names(scene)), scene.resolution.solver
        return Effect(f"rest lattices (accuracy.solver = {solver}) for {bodies}, in the liquid")
