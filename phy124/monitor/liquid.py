"""LiquidDissipation: reports how much energy a liquid with projected pressure loses to each cause.

The remaining loss occurs in the transfers between particles and faces.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.liquid.energies import energy_kernels
from phy124.monitor.dissipation import Dissipation, Loss
from phy124.monitor.observer import Effect, Observer, Subject


class LiquidDissipation(Dissipation):
    """Reads the solver's sums of work on the liquid."""

    in_gathers = False
    in_substeps = True
    kept = ("_energies",)

    def __init__(self) -> None:
        """Prepare the sums of the work on the liquid; the summing starts when `bind` is called."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene requests the lost energy of a liquid by cause."""
        return subject.scene.checks.energy and subject.scene.projects

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the work by cause."""
        yield from energy_kernels(real)

    @classmethod
    def effect(cls, subject: Subject) -> Effect | None:
        """Return the entry in the report's list of effects; None without liquid."""
        why = "checks.energy is off: the causes of energy loss are not distinguished"
        name = "work on the liquid by cause"
        return Effect(name, cls.called_for(subject), why) if subject.scene.projects else None

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which then sums work."""
        self._energies = solver.energies
        solver.keep_works()

    def open(self) -> None:
        """Sum the work from now on."""
        self._energies.clear()

    def loss(self, gained: float, rubbed: float, stored: float) -> Loss:
        """Return the energy [J] lost to viscosity, to friction at walls, and to numerical errors.

        `rubbed` is the negative work of walls (with friction), and `stored` is zero.
        """
        works = self._energies.read()
        lost = rubbed + works.walls - gained
        viscous, friction = 0.0 - works.viscous, 0.0 - works.friction
        return Loss(viscous, friction, lost - viscous - friction)

    def details(self, loss: Loss, change: float, stored: float) -> dict[str, Any]:
        """Return the work [J] of each cause, and the parts of the numerical loss. `change` is the
        change of the kinetic energy.
        """
        works = self._energies.read()
        return {
            "kinetic": change,
            "forces": change + loss.total - works.walls,
            "walls": works.walls,
            "projection": 0.0 - works.projection,
            "density": works.density,
            "transfers": loss.numerical + works.projection - works.density,
        }
