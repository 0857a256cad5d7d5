"""Watchdog: checks after each frame that the state is valid and that momentum and energy balance.

A state is valid if all values are finite and at most a few particles are inverted (det F < 0).
Explicit MPM only loses energy, so a gain means that the run is unstable. The watchdog only reads
the state; the solver repairs invalid deformations (phy124/mpm/repair.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from phy124.gaussians import Frame
from phy124.kernels.diagnostics import make_totals
from phy124.monitor.diagnostics import (
    Diagnostics,
    Totals,
    compute_energies,
    compute_speeds,
    describe_particle,
    find_broken,
)
from phy124.monitor.dissipation import Dissipation
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.observer import Observer, Subject, Violation, find
from phy124.mpm import Unstable

if TYPE_CHECKING:
    from phy124.liquid import AnySolver

INSIDE_OUT = 0.01
"""Largest accepted fraction of inverted particles."""
FEW = 2
"""Number of inverted particles that is always accepted."""
ENERGY_GAIN = 0.25
"""Tolerated spurious energy, relative to the largest supplied energy.

The spurious energy was below 0.7 % in 99 % of 6,500 random scenes. In the worst scene, the spurious
energy reached 13 %. In an unstable run, the spurious energy exceeds any limit within a few frames.
"""
EXCHANGE_GAIN = 0.25
"""The user gets a note if the exchange between a liquid and bodies creates more energy than this
fraction of the largest supplied energy. In 14 test scenes, the created energy is at most 15 %. In 3
scenes with foam or very light bodies, the created energy is 77 to 148 % (docs/design/liquids.md).
"""
MOMENTUM_GAIN = {"float32": 1e-3, "float64": 1e-6}
"""Tolerated spurious momentum, relative to the transferred momentum."""
PROJECTED = 0.5
"""Tolerated spurious momentum of a projected liquid, relative to the transferred momentum. Layers
thinner than a cell exert up to a quarter less than their weight on walls. When objects that are two
cells wide hit the floor, the measured momentum is up to 35 % too small.
"""
LEVEL = 0.05
"""Error of the height of a resting liquid's surface [cells]. The reference for spurious energy is
at least the energy that lifts the liquid by this height.
"""
COVERED = 0.2
"""If the level of a projected liquid rises by at most this height [cells], the user gets a note,
but the run does not stop. If a lid or a body covers the surface, the liquid fills its uppermost
cells: in 16 scenes with lids, the spurious energy was at most the energy of a rise by 0.15 cells.
"""
CROWDED = 0.1
"""Largest mean excess of density of a projected liquid that has enough space."""
ROUNDING = {"float32": 1e-5, "float64": 1e-12}
"""Largest energy loss by rounding, relative to the sum of absolute work."""
QUIET = 1e-9
"""Energies below this multiple of volume times stiffness count as rounding errors."""
UNSEEN = 3e-4
"""Largest invisible strain: 0.1 pixels in an object of 300 pixels."""
FADING = {"float32": 2e-9, "float64": 4e-18}
"""Largest strain per substep due to rounding errors of F.

In a stiff body that rotates slowly, F changes in a substep by less than its last digit. The
measured strain per substep in float32 is 3e-10, or 7e-10 with half the `accuracy.cfl`. A quarter of
the elastic energy at this strain is tolerated. Elastic energy is quadratic in the strain, so the
tolerated strain is half of this strain.
"""
FAST = ("solver", "cells", "push")
ROUNDED = ("precision",)
"""Causes of errors for `phy124.budget.remedies`: fast particles, and rounding."""
SWOLLEN = 2.0
"""Volume ratio above which a real solid would have fractured."""
SQUEEZED = 0.5
"""Volume ratio below which the law or a push may have caused an instability."""


@dataclass
class Balance:
    """Energy and momentum of a run so far."""

    turnover: float = 0.0
    """Largest value of `energy_supplied` [J]."""
    moved: float = 0.0
    """Sum of all transferred momentum [kg m/s]."""
    energy_gain: float = 0.0
    """Spurious energy, relative to `turnover`."""
    momentum_gain: float = 0.0
    """Spurious momentum, relative to the transferred momentum."""
    trembles: float = 0.0
    """Spurious energy explained by rounding errors, relative to `turnover`."""
    lifts: float = 0.0
    """Height of the rise of a projected liquid that explains the spurious energy [cells]."""


def energy_supplied(start: float, work: float, walls: float) -> float:
    """Return the energy [J] that an object had at the start or gained later, and can therefore
    lose.

    `walls` is the work of the walls [J]. Negative work of the walls is energy lost to friction.
    """
    return start + max(work - min(walls, 0.0), 0.0)


class Watchdog(Observer):
    """Checks one run; checks the balance only if the run also has the observer `ExternalWork`."""

    kept = (
        "_begun",
        "_stopped",
        "_pushed",
        "min_J",
        "max_J",
        "first",
        "last",
        "balance",
    )

    def __init__(self) -> None:
        self.balance = Balance()
        self._begun, self._closely = False, False

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum momentum and energy."""
        yield from (make_totals(law, real) for law in subject.laws)

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver in its initial state."""
        self._solver = solver
        self.model, self.state, self.clock = solver.model, solver.state, solver.clock
        self.external = find(observers, ExternalWork)
        self._dissipation = find(observers, Dissipation)
        self._totals = self.totals_of(solver)
        self.first = self.last = self._totals.read(self.clock)
        self.min_J, self.max_J = self.first.min_J, self.first.max_J
        self._stopped, self._pushed = solver.pairs.impulse(), solver.free.impulses()

    def totals_of(self, solver: AnySolver) -> Totals:
        """Return the sums over the solver's state."""
        return Totals(solver.model, solver.state)

    def before_attempt(self, *, closely: bool = False) -> None:
        """Start to sum the external work of a frame.

        If `closely` is set, each substep is checked for non-finite particles, before they affect
        their neighbours.
        """
        self._closely = closely
        if not self._begun:
            # The balance does not start in `bind`, because the run may have been resumed after
            # `bind`.
            self.first = self.last = self._totals.read(self.clock)
            turnover = max(self.first.energy, self._strain_energy(math.sqrt(QUIET)))
            self.balance = Balance(turnover, math.sqrt(2 * self.model.total_mass * turnover))
            self._stopped = self._solver.pairs.impulse()
            self._pushed = self._solver.free.impulses()
            if self.external is not None:
                self.external.open(self.clock)
            if self._dissipation is not None:
                self._dissipation.open()
            self._begun = True
        if self.external is not None:
            self.external.begin(self.last.momentum)

    def restart(self) -> None:
        """Restart the balance with the next frame, because the state has been changed."""
        self._begun = False

    def after_substep(self) -> None:
        """Check the particles if the attempt is checked closely.

        Raises:
            Unstable: The state of a particle is not finite.
        """
        if self._closely and (count := len(find_broken(self.state))):
            raise Unstable(f"{count} particles are NaN or infinite")

    def after_attempt(self) -> Violation | None:
        """Check a frame; return the error, or None."""
        now = self._totals.read(self.clock)
        balanced = self.external is not None
        problem = self._check_room() or self._check_deformation(now)
        problem = problem or (self._check_balance(now) if balanced else None)
        if problem is None:
            self.last = now
            self.min_J, self.max_J = min(self.min_J, now.min_J), max(self.max_J, now.max_J)
        return problem

    def diagnose(self, problem: str) -> Violation:
        """Return the reason why the solver stopped, and the particle that caused it."""
        broken = find_broken(self.state)
        if len(broken):
            return Violation(f"{problem}, first {self._describe(int(broken[0]))}", self._unstable())
        index = int(compute_speeds(self.state).argmax())
        return Violation(f"{problem}; the fastest is {self._describe(index)}", FAST)

    def notes(self) -> list[str]:
        """Return notes about the course of the run."""
        notes = []
        if self._solver.repair.count:
            first = self._describe(self._solver.repair.first)
            notes.append(
                f"{self._solver.repair.count} times a particle was deformed beyond the range "
                f"of its law and was reset to its shape at rest; the first one was {first}. A "
                "gentler push or a stiffer material avoids this."
            )
        if self._solver.outliers.most:
            notes.append(
                f"{self._solver.outliers.most} particles left the simulated space; they continued "
                "on parabolas without contact."
            )
        notes += self._notes_of_laws()
        if self.max_J > SWOLLEN and not any(m.disperses for m in self.model.materials):
            notes.append(
                f"Some of the material swelled to {self.max_J:.2g} times its volume; a real "
                "solid would have broken. The motion is too fast for the stiffness; a "
                "slower motion or a stiffer material avoids this."
            )
        solver: Any = self._solver
        lasting = getattr(solver, "liquid", solver).lasting if solver.projects else 0.0
        if lasting > CROWDED:
            notes.append(
                f"The space between the walls is smaller than the liquid, whose density rose by "
                f"{lasting:.0%}. Move the walls apart, or use less liquid."
            )
        gain = self._dissipation.false_gain() if self._dissipation is not None else 0.0
        if gain > EXCHANGE_GAIN * self.balance.turnover:
            notes.append(
                "The exchange between the liquid and the bodies created "
                f"{gain / self.balance.turnover:.0%} of the supplied energy, which other losses "
                "may hide. A heavier or stiffer body or a finer grid may avoid this."
            )
        return [*notes, *self._notes_of_balance()]

    def _notes_of_balance(self) -> Iterator[str]:
        if self.balance.trembles:
            yield (
                "The motion is so slow for the stiffness that rounding errors created "
                f"{self.balance.trembles:.0%} of the energy. The tremor is less than {UNSEEN:g} of "
                "the object's size, which is too small to see. accuracy.precision = float64 avoids "
                "it."
            )
        if self.balance.lifts:
            yield (
                f"The liquid rose by {self.balance.lifts:.2g} cells without a physical cause, as "
                "it may in layers thinner than a cell, or when a lid or a body covers its surface. "
                "A larger accuracy.cells makes this error smaller."
            )

    def _notes_of_laws(self) -> Iterator[str]:
        by_law = {material.device_law: material for material in self.model.materials}
        for group in self.model.groups:
            part = group.particles
            if group.law.project is not None:
                density = self.model.mass.numpy()[part] / self.model.volume.numpy()[part]
                history = self.state.history.numpy()[part]
                yield from by_law[group.law].notes_on(density, history)

    def report(self, frames: Sequence[Frame] = ()) -> dict[str, Any]:
        """Return the sections about the balance and the lost energy."""
        balanced = self.external is not None
        balance = {
            "energy_gain": self.balance.energy_gain if balanced else None,
            "momentum_gain": self.balance.momentum_gain if balanced else None,
            "min_J": self.min_J,
            "max_J": self.max_J,
            "inside_out": self.last.inverted,
            "reset": self._solver.repair.count,
            "ballistic": self._solver.outliers.most,
        }
        return {"balance": balance, **self._energy()}

    def _energy(self) -> dict[str, Any]:
        if self._dissipation is None or self.external is None:
            return {}
        turnover = self.balance.turnover
        stored = self.last.elastic - self.first.elastic
        gained, rubbed = self.balance.energy_gain * turnover, -self.external.of_walls()
        loss = self._dissipation.loss(gained, rubbed, stored)
        details = self._dissipation.details(loss, self.last.energy - self.first.energy, stored)
        return {"energy": {"turnover": turnover, "lost": loss.total, **loss._asdict(), **details}}

    def _check_room(self) -> Violation | None:
        """Return an error if a liquid with bodies has too little space. A liquid alone would only
        become denser.
        """
        solver: Any = self._solver
        mixed = hasattr(solver, "liquid") or solver.free.all
        if not (solver.projects and mixed and solver.crowding > CROWDED):
            return None
        return Violation(
            "the walls leave too little room for the liquid and the bodies in it, and the liquid's "
            f"density rose by {solver.crowding:.0%}; move the walls less, or use less liquid",
            (),
        )

    def _check_deformation(self, now: Diagnostics) -> Violation | None:
        what, index = "", 0
        if now.broken:
            what, index = f"{now.broken} particles are NaN or infinite", now.first_broken
        elif now.inverted > max(FEW, INSIDE_OUT * len(self.model)):
            what, index = f"{now.inverted} particles are turned inside out", now.first_inverted
        return (
            Violation(f"{what}, first {self._describe(index)}", self._unstable()) if what else None
        )

    def _check_balance(self, now: Diagnostics) -> Violation | None:
        """Compare energy and momentum with initial values plus external work and impulse."""
        assert self.external is not None
        outside = self.external.total(self.clock, now.middle - self.first.middle)
        outside = outside.plus(self._solver.free.impulses() - self._pushed)
        turnover = max(
            self.balance.turnover,
            now.energy,
            energy_supplied(self.first.energy, outside.work, self.external.of_walls()),
            abs(outside.work),
            ROUNDING[self.model.precision] * outside.turned,
            self._energy_of_lift(LEVEL),
        )
        gained = now.energy - self.first.energy - outside.work
        # The first term is an upper bound of the sum of the norms of all particles' momenta.
        momenta = math.sqrt(2 * self.model.total_mass * now.kinetic)
        moved = max(self.balance.moved, momenta, outside.moved)
        stopped = self._solver.pairs.impulse() - self._stopped
        moved = max(moved, float(np.linalg.norm(stopped)))
        missing = now.momentum - self.first.momentum - outside.impulse - stopped
        momentum_gain = float(np.linalg.norm(missing)) / moved if moved > 0 else 0.0
        # In the half step of a liquid's `lag`, the floor may already resist gravity.
        sure = gained - max(now.lag, 0.0) if self._solver.projects else gained
        problem = self._check_energy(sure, turnover) or self._check_momentum(momentum_gain)
        if problem is None:
            gain = gained / turnover
            self.balance = replace(
                self.balance,
                turnover=turnover,
                moved=moved,
                energy_gain=gain,
                momentum_gain=momentum_gain,
            )
        return problem

    def _check_energy(self, energy: float, turnover: float) -> Violation | None:
        """Return an error if neither rounding nor a liquid's level explains the spurious energy."""
        if energy <= ENERGY_GAIN * turnover:
            return None
        if energy <= self._energy_of_lift(COVERED):
            rise = energy / self._energy_of_lift(1.0)
            self.balance.lifts = max(self.balance.lifts, rise)
            return None
        faded = FADING[self.model.precision] * self.clock.substeps
        if energy <= ENERGY_GAIN * self._strain_energy(min(faded, UNSEEN)):
            self.balance.trembles = max(self.balance.trembles, energy / turnover)
            return None
        index = int(compute_energies(self.model, self.state).argmax())
        who = f"most of the energy is in {self._describe(index)}"
        rounded = energy <= self._strain_energy(faded)
        what = f"{energy / turnover:.0%} of the energy has no physical source; {who}"
        return Violation(what, ROUNDED if rounded else self._unstable())

    def _check_momentum(self, fraction: float) -> Violation | None:
        if fraction <= (
            PROJECTED if self._solver.projects else MOMENTUM_GAIN[self.model.precision]
        ):
            return None
        index = int(compute_speeds(self.state).argmax())
        what = (
            f"{fraction:.2%} of the momentum has no physical source; "
            f"the fastest is {self._describe(index)}"
        )
        return Violation(what, ROUNDED if self.model.precision == "float32" else self._unstable())

    def _unstable(self) -> tuple[str, ...]:
        violent = self.min_J < SQUEEZED or self.clock.stable().limiter in ("speed", "gradient")
        return ("solver", "substep", *(("law", "push") if violent else ()))

    def _strain_energy(self, strain: float) -> float:
        """Return the elastic energy [J] of the whole body at a strain."""
        stiffest = max(m.density * m.wave_speed() ** 2 for m in self.model.materials)
        volume = float(np.sum(self.model.volume.numpy(), dtype=np.float64))
        return stiffest * volume * strain**2

    def _energy_of_lift(self, cells: float) -> float:
        """Return the energy [J] that lifts a projected liquid by a number of cells."""
        pull = getattr(self.clock, "pull", None)
        if pull is None:
            return 0.0
        return cells * self.model.dx * self.model.total_mass * float(np.linalg.norm(pull))

    def _describe(self, index: int) -> str:
        return describe_particle(self.model, self.state, index)
