"""LatticeDissipation: reports how much energy bodies on lattices lose to each cause.

The work of all causes adds up to the change of the kinetic energy, except for rounding errors,
which the report shows.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.kernels.lattice.work import make_contact_work, make_node_work
from phy124.monitor.diagnostics import Diagnostics
from phy124.monitor.dissipation import Loss
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.liquid import LiquidDissipation
from phy124.monitor.observer import Effect, Observer, Subject, find


class LatticeDissipation(LiquidDissipation):
    """Reads the solver's sums of the work on bodies on lattices."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene requests the lost energy by cause."""
        return subject.scene.checks.energy

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the work by cause."""
        yield from (make_node_work(real), make_contact_work(real))

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        why = "checks.energy is off: the causes of energy loss are not distinguished"
        return Effect("work of forces, stress and contact", cls.called_for(subject), why)

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver and to the work of the stiffening of the material."""
        super().bind(solver, observers)
        self._external = find(observers, ExternalWork)

    def divide(self, first: Diagnostics, last: Diagnostics) -> dict[str, float]:
        """Return losses, changes of energy, and work of each cause [J].

        All values refer to the time of the velocities, which is half a substep before the time of
        the positions.
        """
        works = self._energies.read()
        stiffened = self._external.stored if self._external is not None else 0.0
        kinetic = last.kinetic - first.kinetic
        elastic = last.elastic + last.lag - first.elastic - first.lag
        unexplained = sum(works) - kinetic
        substeps = stiffened - works.elastic - elastic
        # Losses are subtracted from 0.0, because the negative of zero would be written as -0.0.
        contact = works.friction + works.impacts + works.itself + works.pairs
        loss = Loss(0.0 - works.viscous, 0.0 - contact, unexplained + substeps - works.shock)
        return {
            "lost": loss.total,
            **loss._asdict(),
            "kinetic": kinetic,
            "elastic": elastic,
            "forces": works.forces,
            "walls": works.walls,
            "held": works.held,
            "solids": works.solids,
            "stiffening": stiffened,
            "friction": 0.0 - works.friction,
            "impacts": 0.0 - works.impacts,
            "pairs": 0.0 - works.pairs,
            "itself": 0.0 - works.itself,
            "shock": 0.0 - works.shock,
            "substeps": substeps,
            "unexplained": unexplained,
        }
