"""Observers of runs in which some bodies are on lattices and the others consist of particles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Wrench
from phy124.kernels.lattice.contact import MOMENT
from phy124.monitor.contacts import Contacts
from phy124.monitor.diagnostics import Diagnostics, Totals
from phy124.monitor.external_work import MEAN, ExternalWork
from phy124.monitor.lattice import LatticeContacts, LatticePairs, LatticeTotals, LatticeWatchdog
from phy124.monitor.observer import Effect, Observed, Observer, Subject
from phy124.monitor.wrenches import Wrenches, simple_wall_names, wall_names
from phy124.mpm import Attachable, Clock, Grid
from phy124.scene import Scene

if TYPE_CHECKING:
    from phy124.lattice.coupled import CoupledSolver


class CoupledTotals(Totals):
    """Sums of momentum and energy over particles and lattice nodes."""

    def __init__(self, solver: CoupledSolver) -> None:
        super().__init__(solver.model, solver.state)
        lattice = solver.lattice
        self._points, self._nodes = Totals(lattice.model, lattice.state), LatticeTotals(lattice)

    def read(self, clock: Clock) -> Diagnostics:
        """Return the diagnostics of the current state."""
        every, points, nodes = (
            super().read(clock),
            self._points.read(clock),
            self._nodes.read(clock),
        )
        return replace(
            every,
            momentum=every.momentum - points.momentum + nodes.momentum,
            angular=every.angular - points.angular + nodes.angular,
            kinetic=every.kinetic - points.kinetic + nodes.kinetic,
            middle=every.middle - points.middle + nodes.middle,
        )


class CoupledWatchdog(LatticeWatchdog):
    """Checks a run with both lattices and particles."""

    def totals_of(self, solver: Any) -> Totals:
        """Return the sums over nodes and particles."""
        return CoupledTotals(solver)


class CoupledWork(ExternalWork):
    """Sums the external impulse and work on bodies on lattices and on bodies of particles."""

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which also sums the impulses of walls on lattices."""
        self._solver = solver
        super().bind(solver, observers)

    def _read_impulses(self) -> None:
        """Keep the impulses of the previous walls, and sum the impulses of the new walls."""
        sums = self._solver.lattice.walls.sums
        if self._device.get(MEAN, sums) is not sums:
            self._closed[MEAN] = self._closed[MEAN] + self._open(MEAN)
        self._device[MEAN] = sums

    def _record_uniform(self, grid: Grid) -> wp.Launch | None:
        # `CoupledSolver.bind` replaces the walls of the lattices before it records the launches.
        self._read_impulses()
        return super()._record_uniform(grid)


class CoupledWrenches(Wrenches):
    """Measures the wrenches (forces and torques) on walls and between bodies."""

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> Sequence[Attachable]:
        """Return the walls, and add stages to a substep that measure the impulse of each wall."""
        self._rows: dict[str, list[int]] = {}
        """Rows of the lattices' sums for each simple wall, and for each boundary with its parts."""
        of_parts = zip(wall_names(walls), walls, strict=True)
        boundaries = [name for name, wall in of_parts for _ in wall.parts()]
        for row, names in enumerate(zip(boundaries, simple_wall_names(walls), strict=True)):
            for name in dict.fromkeys(names):
                self._rows.setdefault(name, []).append(row)
        return super().wrap_walls(walls, inner)

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver."""
        super().bind(solver, observers)
        self._before = self._now()

    def before_attempt(self, *, closely: bool = False) -> None:
        """Store the impulses of walls on lattices at the start of the frame."""
        super().before_attempt(closely=closely)
        self._before = self._now()

    def of_wall(self, wall: str, centre: NDArray, fps: float) -> Wrench:
        """Return the mean force and torque on a wall since the start of the frame."""
        force, torque = super().of_wall(wall, centre, fps)
        row = (self._before - self._now())[self._rows.get(wall, [])].sum(axis=0)
        impulse, moment = row[:3], row[MOMENT : MOMENT + 3]
        return Wrench(force + fps * impulse, torque + fps * (moment - np.cross(centre, impulse)))

    def _now(self) -> NDArray[np.float64]:
        solver: Any = self._solver
        sums: NDArray[Any] = solver.lattice.walls.sums.numpy()
        return sums.astype(np.float64)


class CoupledContacts(Contacts):
    """Measures the force of walls on each Gaussian, for particles and lattices."""

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that measure a wall on grids and on lattices."""
        yield from super().kernels(subject, real)
        yield from LatticeContacts.kernels(subject, real)

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Sum the impulses of walls on lattices from now on."""
        self._lattices = LatticeContacts()
        self._lattices.bind(solver.lattice)

    def change(self, scene: Scene) -> None:
        """Sum the impulses of new walls on lattices from now on."""
        self._lattices.change(scene)

    def before_attempt(self, *, closely: bool = False) -> None:
        """Set the sums of impulses to zero."""
        super().before_attempt(closely=closely)
        self._lattices.before_attempt()

    def find_nearest(self, setup: Observed) -> NDArray[np.int64]:
        """Return the Gaussian that receives the impulse on each particle, surface point or node."""
        return np.concatenate([super().find_nearest(setup), self._lattices.find_nearest(setup)])

    def read_impulses(self, setup: Observed) -> NDArray[np.float64]:
        """Return the impulses [N s] on particles, surface points and nodes."""
        return np.concatenate([super().read_impulses(setup), self._lattices.read_impulses(setup)])


class CoupledPairs(LatticePairs):
    """Adds the bodies on lattices to the report's list of effects."""

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects before a run."""
        bodies = ", ".join(elastic_names(subject.scene))
        return Effect(f"rest lattices (accuracy.solver = lattice) for {bodies}; others by MPM")

    def finished_effect(self, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects after a run."""
        return self.effect(subject)


def elastic_names(scene: Scene) -> list[str]:
    """Return the names of the objects that are simulated on lattices."""
    return [name for name, soft in zip(scene.names, scene.on_lattices, strict=True) if soft]
