"""PoolDissipation: reports how much energy a liquid and the bodies in it lose to each cause.

The energy that the pressure takes from the liquid and from walls should equal the energy that the
bodies receive. The difference is the loss by the pressure equation; a negative loss is energy that
the coupling created.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.lattice.work import make_contact_work, make_node_work
from phy124.liquid.energies import energy_kernels
from phy124.monitor.dissipation import Dissipation, Loss
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.liquid import LiquidDissipation
from phy124.monitor.observer import Observed, Observer, Subject, find
from phy124.mpm import Model, State
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self


class PoolDissipation(LiquidDissipation):
    """Energy losses by cause of a liquid and of freely moving solids in the liquid."""

    kept = ("_energies", "_begun", "_others")

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which then sums work."""
        self._solver, self._external = solver, find(observers, ExternalWork)
        self._energies = self._liquid(solver).energies
        solver.keep_works()
        self._begun, self._others = self._sum_exchange(), self._of_solids(every=True)

    def _liquid(self, solver: Any) -> Any:
        return solver

    def open(self) -> None:
        """Sum the work from now on."""
        super().open()
        self._begun, self._others = self._sum_exchange(), self._of_solids(every=True)

    def exchange(self) -> dict[str, float]:
        """Return the work [J] of the liquid's pressure on each solid and body."""
        works = (self._sum_exchange() - self._begun).tolist()
        return dict(zip(self._names(), works, strict=True))

    def false_gain(self) -> float:
        """Return the energy [J] that the exchange between liquid and bodies has created.

        A rising light body leaves a wake, which the displacements that restore the density fill.
        The work on the body then comes from the liquid's potential energy.
        """
        projection = self._projection()
        return max(0.0, min(-projection, -projection - self._energies.read().density))

    def loss(self, gained: float, rubbed: float, stored: float) -> Loss:
        """Return the energy [J] lost to the materials, to contact, and to numerical errors, for
        liquid and bodies together.
        """
        works, bodies = self._energies.read(), self._of_bodies(stored)
        lost = rubbed + works.walls + bodies["walls"] - gained
        material, contact = bodies["material"] - works.viscous, bodies["contact"] - works.friction
        return Loss(material, contact, lost - material - contact)

    def details(self, loss: Loss, change: float, stored: float) -> dict[str, Any]:
        """Return the changes of energy, the work of each cause, and the parts of the numerical loss
        [J].
        """
        works, bodies = self._energies.read(), self._of_bodies(stored)
        projection = self._projection()
        external = self._external
        outer = {
            "walls": works.walls + bodies["walls"],
            "solids": 0.0 - float((self._of_solids(every=True) - self._others).sum()),
            "stiffening": external.stored if external is not None else 0.0,
        }
        shock = bodies.get("shock", 0.0)
        return {
            "kinetic": change - stored,
            "elastic": stored,
            "forces": change + loss.total - sum(outer.values()),
            **outer,
            "exchange": self.exchange(),
            "projection": projection,
            "density": works.density,
            "shock": shock,
            "transfers": loss.numerical - projection - works.density - shock,
        }

    def _projection(self) -> float:
        """Return the energy [J] lost in the pressure equation and in the coupling."""
        return 0.0 - self._energies.read().projection - sum(self.exchange().values())

    def _of_bodies(self, stored: float) -> dict[str, float]:
        """Return the work of moving walls on the bodies, and the bodies' losses by cause [J]."""
        return {"walls": 0.0, "material": 0.0, "contact": 0.0}

    def _names(self) -> list[str]:
        return [solid.name for solid in self._solver.free.all]

    def _sum_exchange(self) -> NDArray[np.float64]:
        return self._of_solids(every=False)

    def _of_solids(self, *, every: bool) -> NDArray[np.float64]:
        """Return the work [J] on each freely moving solid by liquids, or by all causes."""
        if not self._solver.free.all:
            return np.zeros(0)
        wet = sorted(self._solver.model.wet) or [0]
        works = self._solver.free.works()
        return -(works if every else works[:, wet]).sum(axis=1)


class MixedDissipation(PoolDissipation):
    """Energy losses by cause of a liquid and of particle bodies."""

    kept = (*PoolDissipation.kept, "_stress")

    in_gathers = True
    in_substeps = False

    def __init__(self) -> None:
        super().__init__()
        self._stress = Dissipation()

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the work on liquid and bodies."""
        yield from energy_kernels(real)
        yield from Dissipation.kernels(without_liquids(subject), real)

    def allocate(self, model: Model, workers: int) -> None:
        """Allocate arrays for the accumulated work of the stress."""
        self._stress.allocate(model, workers)

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """Record the kernel launch that sums the work of the stress on a worker's particles of one
        law.

        Args:
            part: A worker's particles of one law.
            worker: Index of the worker.
            model: The particles' constants.
            state: The state after the gather.
            tracks: Quantities that change over time.
        """
        return self._stress.record(part, worker, model, state, tracks)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        observer = super().of(setup)
        observer.change(setup.scene)
        return observer

    def change(self, scene: Scene) -> None:
        """Store whether the walls of a scene move."""
        self._driven = any(wall.moves for wall in scene.boundaries)

    def _liquid(self, solver: Any) -> Any:
        return solver.liquid

    def _of_bodies(self, stored: float) -> dict[str, float]:
        """Return the bodies' losses and the work of moving walls, including friction [J]."""
        assert self._external is not None
        work = self._external.of_grids()
        walls, contact = (work, 0.0) if self._driven else (0.0, 0.0 - work)
        material = self._stress.loss(0.0, 0.0, stored).material
        return {"walls": walls, "material": material, "contact": contact}

    def _names(self) -> list[str]:
        return [*super()._names(), *self._solver.bodies.names]

    def _sum_exchange(self) -> NDArray[np.float64]:
        return np.concatenate([super()._sum_exchange(), self._solver.bodies.work.total])


class ImmersedDissipation(PoolDissipation):
    """Energy losses by cause of a liquid and of bodies on lattices."""

    kept = (*PoolDissipation.kept, "_lattice")

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the work by cause."""
        yield from super().kernels(subject, real)
        yield from (make_node_work(real), make_contact_work(real))

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which then sums work."""
        super().bind(solver, observers)
        self._lattice = solver.lattice.energies

    def _liquid(self, solver: Any) -> Any:
        return solver.liquid

    def open(self) -> None:
        """Sum the work from now on."""
        super().open()
        self._lattice.clear()

    def _of_bodies(self, stored: float) -> dict[str, float]:
        works = self._lattice.read()
        return {
            "walls": works.walls + works.held,
            "material": 0.0 - works.viscous,
            "contact": 0.0 - works.friction - works.impacts - works.itself - works.pairs,
            "shock": 0.0 - works.shock,
        }

    def _names(self) -> list[str]:
        return list(self._solver.bodies.names)

    def _sum_exchange(self) -> NDArray[np.float64]:
        return np.concatenate([super()._sum_exchange(), self._solver.bodies.work.total])


def without_liquids(subject: Subject) -> Subject:
    """Return the properties of a run, without the materials that are liquids."""
    solid = [section for section in subject.materials if section.device_law.name != "fluid"]
    return subject._replace(materials=solid)
