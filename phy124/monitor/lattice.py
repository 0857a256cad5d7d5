"""Observers of bodies on lattices: momentum, energy, and the impulse and work of walls.

The kernel of the contact with a wall sums impulse, moment and work
(phy124/kernels/lattice/contact.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Wrench
from phy124.kernels import diagnostics as at
from phy124.kernels.lattice.contact import MOMENT
from phy124.kernels.lattice.nodes import make_node_totals
from phy124.kernels.work import make_uniform_sums
from phy124.lattice import impulses
from phy124.monitor.contacts import Contacts
from phy124.monitor.diagnostics import Diagnostics, Totals
from phy124.monitor.external_work import MEAN, MeanWork
from phy124.monitor.lattice_dissipation import LatticeDissipation
from phy124.monitor.observer import Cost, Effect, Observed, Observer, Subject
from phy124.monitor.watchdog import Watchdog
from phy124.monitor.wrenches import Wrenches, simple_wall_names
from phy124.mpm import Attachable, Clock
from phy124.mpm.model import Group
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.lattice.solver import LatticeSolver


class LatticeTotals(Totals):
    """Sums the momentum and kinetic energy over nodes, and all other quantities over points."""

    on_lattice = True

    def __init__(self, solver: LatticeSolver) -> None:
        self._crew = solver.crew
        super().__init__(solver.model, solver.state)
        model, nodes = solver.model, solver.nodes_state
        self._of_nodes = wp.zeros(at.SUMS, dtype=wp.float64, device=model.device)
        inputs = [nodes.inverse, nodes.rest, nodes.u, nodes.v]
        kernel = make_node_totals(model.real)
        self._launch = model.launch(kernel, len(nodes.u), inputs, [self._of_nodes])

    def _sum(self, group: Group, outputs: list[wp.array]) -> list[wp.Launch | None]:
        if self._crew.vectors(group):
            return self._crew.totals(group, outputs)
        return super()._sum(group, outputs)

    def read(self, clock: Clock) -> Diagnostics:
        """Return the diagnostics; first move the points with their nodes."""
        points = super().read(clock)
        self._of_nodes.zero_()
        if self._launch is not None:
            self._launch.launch()
        total: NDArray[Any] = self._of_nodes.numpy()
        return replace(
            points,
            momentum=total[at.MOMENTUM : at.MOMENTUM + 3].copy(),
            angular=total[at.ANGULAR : at.ANGULAR + 3].copy(),
            kinetic=float(total[at.KINETIC]),
            middle=total[at.MIDDLE : at.MIDDLE + 3].copy(),
        )


class LatticeWatchdog(Watchdog):
    """Checks a run of bodies on lattices."""

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield nothing; the kernels of lattices compute the sums."""
        yield from ()

    def totals_of(self, solver: Any) -> Totals:
        """Return the sums over nodes and points."""
        return LatticeTotals(solver)

    def _energy(self) -> dict[str, Any]:
        divided = self._dissipation
        if not isinstance(divided, LatticeDissipation):
            return super()._energy()
        losses = divided.divide(self.first, self.last)
        return {"energy": {"turnover": self.balance.turnover, **losses}}


class LatticeWork(MeanWork):
    """External impulse and work from the solver's sums.

    If there are other forces, the work of a constant acceleration is also summed in every substep.
    The product of acceleration and displacement would be less exact, because positions are known
    half a substep later than velocities. For a body in a wind that blows against gravity, the error
    of this product was 32 % of the energy.
    """

    _solver: Any = None

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernel for the work of a uniform acceleration, if needed."""
        if _sums_uniform_work(subject):
            yield make_uniform_sums(real)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        return cls(summed=_sums_uniform_work(setup.subject))

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, whose walls store the sums."""
        self._solver = solver
        self._device[MEAN] = solver.walls.sums
        super().bind(solver, observers)

    def change(self, scene: Scene) -> None:
        """Keep the impulses of the previous walls, and sum the impulses of the new walls."""
        self._closed[MEAN] = self._closed[MEAN] + self._open(MEAN)
        self._device[MEAN] = self._solver.walls.sums
        self._solver.record()

    def _rows_of_bodies(self) -> list[wp.array]:
        if self._solver is None:
            return super()._rows_of_bodies()
        return [self._solver.free.rows(), *self._solver.pairs.rows()]

    def _from_bodies(self) -> NDArray[np.float64]:
        if self._solver is None:
            return super()._from_bodies()
        impulse: NDArray[np.float64] = self._solver.free.impulses()[:3]
        return impulse + self._solver.pairs.impulse()


def _sums_uniform_work(subject: Subject) -> bool:
    scene = subject.scene
    others = scene.boundaries or scene.objects or not all(f.uniform for f in scene.acting)
    return subject.changes or bool(others)


class LatticeWrenches(Wrenches):
    """Wrenches (forces and torques) on walls and between bodies, from the solver's sums."""

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield nothing; the solver measures the walls."""
        yield from ()

    @property
    def walls(self) -> tuple[str, ...]:
        """Names of the simple walls."""
        return self._names if self._of_walls else ()

    def wrap_walls(self, walls: Sequence[Boundary], inner: Sequence[Attachable]) -> Any:
        """Return the walls unchanged; store their names."""
        self._names = tuple(simple_wall_names(walls))
        return inner

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, whose walls store the sums."""
        super().bind(solver, observers)
        self._before = self._now()

    def before_attempt(self, *, closely: bool = False) -> None:
        """Store the impulses at the start of the frame."""
        self._before = self._now()

    def of_wall(self, wall: str, centre: NDArray, fps: float) -> Wrench:
        """Return the mean force and torque on a wall since the start of the frame."""
        row = (self._before - self._now())[self._names.index(wall)]
        impulse, moment = row[:3], row[MOMENT : MOMENT + 3]
        return Wrench(fps * impulse, fps * (moment - np.cross(centre, impulse)))

    def _read_impulses(self) -> None:
        """Do nothing, because the solver itself sums the impulses of walls."""

    def _now(self) -> NDArray[np.float64]:
        sums: NDArray[Any] = self._solver.walls.sums.numpy()
        return sums.astype(np.float64)


class LatticeContacts(Contacts):
    """Force of walls on each Gaussian, from the impulses on points and clamped nodes."""

    in_substeps = False

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the impulses of walls."""
        if subject.scene.boundaries:
            yield from impulses.kernels(real)

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects; the sums take less time than
        contact.
        """
        return super().effect(subject)._replace(cost=Cost())

    def wrap_walls(self, walls: Sequence[Boundary], inner: Sequence[Attachable]) -> Any:
        """Return the walls unchanged; the solver sums their impulses."""
        return inner

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Sum the impulses of the solver's walls from now on."""
        self._solver = solver
        solver.walls.keep_impulses()
        solver.record()

    def change(self, scene: Scene) -> None:
        """Sum the impulses of the new walls from now on."""
        self.bind(self._solver)

    def before_attempt(self, *, closely: bool = False) -> None:
        """Set the sums of impulses to zero."""
        self._solver.walls.impulses.sums.zero_()

    def find_nearest(self, setup: Observed) -> NDArray[np.int64]:
        """Return the nearest Gaussian of the same object for each surface point and node [S+N]."""
        surface, lattice = self._solver.surface, self._solver.lattice
        x = np.concatenate([surface.x, lattice.x])
        body = np.concatenate([surface.body, lattice.body])
        moving, names = setup.scenery.moving, self._solver.model.names
        nearest = np.zeros(len(x), np.int64)
        for index in range(self._solver.model.bodies):
            chosen = np.arange(len(moving))
            if moving.object_id is not None and names:
                number = setup.scene.names.index(names[index])
                chosen = np.flatnonzero(moving.object_id == number)
            mine = body == index
            nearest[mine] = chosen[scipy.spatial.KDTree(moving.means[chosen]).query(x[mine])[1]]
        return nearest

    def read_impulses(self, setup: Observed) -> NDArray[np.float64]:
        """Return the impulse on each surface point and then on each node [S+N,3], N s."""
        sums: NDArray[np.float64] = self._solver.walls.impulses.sums.numpy()
        return sums


class LatticeMethod(Observer):
    """Adds an entry about the solver to the report's list of effects."""

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        solver = subject.scene.resolution.solver
        return Effect(
            f"rest lattice (accuracy.solver = {solver}): no transfers, no tearing, no sorting"
        )


class LatticeShock(Observer):
    """Adds an entry about artificial viscosity to the report's list of effects."""

    NAME = "artificial viscosity in fast compression"

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects before a run."""
        return Effect(f"{cls.NAME}, if material is compressed nearly as fast as sound")

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the clock of the lattices."""
        self._clock = getattr(solver.lattice, "clock", solver.clock)

    def finished_effect(self, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects after a run."""
        count = self._clock.shocked
        why = "nothing was compressed nearly as fast as sound"
        return Effect(f"{self.NAME}, in {count:,} substeps" if count else self.NAME, count > 0, why)


class LatticePairs(Observer):
    """Adds an entry about contact between bodies to the report's list of effects."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene has several objects."""
        return bool(subject.scene.objects)

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects before a run."""
        return Effect("contact of surface points between objects")

    def finished_effect(self, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects after a run."""
        most = sum(meeting.most for meeting in self._solver.meetings.of_pairs)
        name = f"contact between objects, at most at {most} surface points"
        return Effect(name, most > 0, "no objects came near each other")


class LatticeSelfContact(Observer):
    """Adds an entry about contact of a body with itself to the report's list of effects."""

    LOOKING = Cost(fixed=40e3)
    """Cost of the search for close parts of an object with 50,000 points."""

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects before a run."""
        return Effect("self-contact, if parts come near each other", cost=cls.LOOKING)

    def finished_effect(self, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects after a run."""
        most = max((m.most for m in self._solver.meetings.of_bodies), default=0)
        name = f"self-contact of at most {most} pairs of points" if most else "self-contact"
        return Effect(name, most > 0, "no parts came near each other", self.LOOKING)
