"""The watchdog: checks once per frame whether the state is sound and the balances add up.

A violation is a sentence. What is checked, with the limits below: every number is finite; no
more than a few particles are turned inside out; volume ratios stay in range; momentum changes by
what forces and walls gave; energy does not grow beyond the work they did (explicit MPM only loses
energy, so more means that the run is exploding). Which particle it is and what to change is
looked for only then (phy124/monitor/diagnosis.py). The watchdog reads the run and writes nothing of
it: what no law can work with is mended by the solver's own repair (phy124/mpm/repair.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from phy124.monitor import diagnosis
from phy124.monitor.diagnostics import Diagnostics, energies, speeds
from phy124.monitor.dissipation import Dissipation
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.tearing import Tearing
from phy124.mpm import Solver, Unstable

INSIDE_OUT = 0.01
"""Largest fraction of particles turned inside out at which the result is still right."""
FEW = 2
"""This many are never too many; they are reset before the next frame, and counted."""
ENERGY_GAIN = 0.25
"""Tolerated spurious energy, as a fraction of the largest energy turned over.

Of 6,500 random scenes one in a hundred reached 0.7 %, the worst 13 % (two particles whose velocity
is set in every substep); an unstable run passes any limit within a few frames.
"""
MOMENTUM_GAIN = {"float32": 1e-3, "float64": 1e-6}
"""Tolerated spurious momentum, as a fraction of all momentum transferred."""
ROUNDING = {"float32": 1e-5, "float64": 1e-12}
"""Fraction of all work, positive and negative, that rounding may lose."""
QUIET = 1e-9
"""Energies below this fraction of volume times stiffness are rounding."""
COLLAPSE = 0.8
"""Speed of impact, in speeds of sound, above which laws that may collapse come close to J = 0."""
UNSEEN = 3e-4
"""Strain that no picture shows: a tenth of a pixel in 300."""
FADING = {"float32": 2e-9, "float64": 4e-18}
"""Strain that rounding of F may leave per substep.

F grows by dt C F. In a stiff body that turns slowly this is less than the last digit of F, and what
rounding omits strains the body. Measured: 3e-10 per substep in float32, 7e-10 with half the
`accuracy.cfl`, however far from the origin. Energies are its squares, and a quarter is tolerated.
"""
FAST = ("push", "cells")
ROUNDED = ("precision",)
"""Causes (`phy124.budget.remedies`) of violations: a run too fast for its window, rounding."""
SWOLLEN = 2.0
"""Volume ratio above which a solid would have broken."""
SQUEEZED = 0.5
"""Volume ratio below which the law or the push may be the cause of an instability."""


class Violation(NamedTuple):
    """What is wrong with a frame."""

    what: str
    """A clause that says what is wrong."""
    causes: tuple[str, ...]
    """Possible causes, for `phy124.budget.remedies`, the likeliest first."""


@dataclass
class Balance:
    """The balance of energy and momentum of a run, updated frame by frame."""

    turnover: float = 0.0
    """Largest energy turned over [J]."""
    moved: float = 0.0
    """All momentum transferred [kg m/s]."""
    energy_gain: float = 0.0
    """Spurious energy, as a fraction of the turnover."""
    momentum_gain: float = 0.0
    """Spurious momentum, as a fraction of what was transferred."""
    trembles: float = 0.0
    """Fraction of the energy created by rounding, if that exceeds what is otherwise tolerated."""


class Watchdog:
    """Watches one run, whose solver has its forces and boundaries from `external`."""

    def __init__(
        self,
        solver: Solver,
        external: ExternalWork,
        *,
        balance: bool = True,
        dissipation: Dissipation | None = None,
    ) -> None:
        self.model, self.state, self.clock = solver.model, solver.state, solver.clock
        self._pairs, self._outliers, self._repair = solver.pairs, solver.outliers, solver.repair
        self.external, self._balanced, self.dissipation = external, balance, dissipation
        self.tearing = Tearing(solver.model, solver.state)
        self.first = self.last = self._look()
        self.balance = Balance()
        self.min_J, self.max_J = self.first.min_J, self.first.max_J
        self._fastest, self._begun = 0.0, False
        self._stopped = self._pairs.impulse()
        self._free = solver.free
        self._pushed = self._free.given()

    def before(self) -> None:
        """Before a frame, whose broken deformations have been mended."""
        if not self._begun:
            self._begin()

    def _begin(self) -> None:
        """Start the balance with the first frame that is watched, since a run may be resumed."""
        self.first = self.last = self._look()
        turnover = max(self.first.energy, self._strained(math.sqrt(QUIET)))
        self.balance = Balance(turnover, math.sqrt(2 * self.model.total_mass * turnover))
        self._stopped, self._pushed = self._pairs.impulse(), self._free.given()
        if self._balanced:
            self.external.open(self.clock)
        self._begun = True

    def snapshot(self) -> dict[str, Any]:
        """The state to continue from, as plain data."""
        return {
            "begun": self._begun,
            "fastest": self._fastest,
            "stopped": self._stopped.tolist(),
            "pushed": self._pushed.tolist(),
            "min_J": self.min_J,
            "max_J": self.max_J,
            "first": self.first.snapshot(),
            "last": self.last.snapshot(),
            "balance": asdict(self.balance),
            "tearing": self.tearing.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self._begun, self._fastest = snapshot["begun"], snapshot["fastest"]
        self._stopped = np.array(snapshot["stopped"])
        self._pushed = np.array(snapshot.get("pushed", self._pushed))
        self.min_J, self.max_J = snapshot["min_J"], snapshot["max_J"]
        self.first, self.last = (Diagnostics.from_snapshot(snapshot[k]) for k in ("first", "last"))
        self.balance = Balance(**snapshot["balance"])
        self.tearing.restore(snapshot["tearing"])

    def after(self) -> Violation | None:
        """Call after a frame: returns what is wrong with it, or None."""
        now = self._look()
        problem = self._unsound(now) or (self._unbalanced(now) if self._balanced else None)
        if problem is None:
            self.tearing.look()
            self.last = now
            self.min_J, self.max_J = min(self.min_J, now.min_J), max(self.max_J, now.max_J)
        return problem

    def follow(self, closely: bool = False) -> Callable[[], None]:
        """A function to call after each substep of the next frame, or after some of them.

        Args:
            closely: Whether it looks each time for a particle that is no longer finite, before that
                one spoils those around it, and raises Unstable.
        """
        if self._balanced:
            self.external.begin(self.last.momentum)

        def after() -> None:
            self._fastest = max(self._fastest, self.clock.recent.speed)
            if closely and (count := len(diagnosis.broken(self.state))):
                raise Unstable(f"{count} particles are NaN or infinite")

        return after

    def diagnose(self, problem: str) -> Violation:
        """The violation for a problem that made the solver give up, with the particle."""
        index = diagnosis.first_broken(self.state)
        if index is not None:
            return Violation(f"{problem}, first {self._who(index)}", self._unstable())
        index = int(speeds(self.state).argmax())
        return Violation(f"{problem}; the fastest is {self._who(index)}", FAST)

    def notes(self) -> list[str]:
        """Sentences that the user should know about how the run went."""
        notes = []
        if self._repair.count:
            first = self._who(self._repair.first)
            notes.append(
                f"{self._repair.count} times a particle was deformed beyond what a law can "
                f"describe and was given its shape at rest, first {first}. A gentler "
                "push or a stiffer material would keep it whole."
            )
        if self._outliers.most:
            notes.append(
                f"{self._outliers.most} particles left the simulated space and continued on "
                "parabolas, without contact."
            )
        fragile = {m.device_law.name: m for m in self.model.materials if m.may_collapse}
        for name, material in sorted(fragile.items()):
            mach = self._fastest / material.sound_speed()
            if mach > COLLAPSE:
                notes.append(
                    f"The law {name} moved at {mach:.1f} times its speed of sound. Where it hits "
                    f"something at more than {COLLAPSE} times, it may stay squeezed flat without "
                    "any other sign; neo_hookean would not."
                )
        for material in self.model.materials:
            notes += material.notes_at(self._fastest)
        if self.max_J > SWOLLEN and not any(m.rounds for m in self.model.materials):
            notes.append(
                f"Somewhere the material swelled to {self.max_J:.2g} times its volume, as no solid "
                "does: it would have broken. It is too fast for its stiffness; a slower motion "
                "or a stiffer material keeps it whole."
            )
        trembles = self.balance.trembles
        if trembles:
            notes.append(
                f"It moves so slowly for its stiffness that rounding created {trembles:.0%} of "
                f"its energy: a tremor of less than {UNSEEN:g} of its size, which no picture "
                "shows. accuracy.precision = float64 avoids it."
            )
        torn = self.tearing.note()
        return [*notes, torn] if torn else notes

    def energy(self) -> dict[str, float] | None:
        """Where the energy lost has gone [J], and all that was turned over; None if not asked."""
        if self.dissipation is None:
            return None
        gained = self.balance.energy_gain * self.balance.turnover
        stored = self.last.elastic - self.first.elastic
        loss = self.dissipation.loss(gained, -self.external.of_walls(), stored)
        return {"turnover": self.balance.turnover, "lost": loss.total, **loss._asdict()}

    def report(self) -> dict[str, Any]:
        """The findings as plain data, for the report of the run."""
        return {
            "energy_gain": self.balance.energy_gain if self._balanced else None,
            "momentum_gain": self.balance.momentum_gain if self._balanced else None,
            "min_J": self.min_J,
            "max_J": self.max_J,
            "inside_out": self.last.inverted,
            "reset": self._repair.count,
            "ballistic": self._outliers.most,
            "tearing": self.tearing.report(),
        }

    def _unsound(self, now: Diagnostics) -> Violation | None:
        what, index = "", 0
        if now.broken:
            what, index = f"{now.broken} particles are NaN or infinite", now.first_broken
        elif now.inverted > max(FEW, INSIDE_OUT * len(self.model)):
            what, index = f"{now.inverted} particles are turned inside out", now.first_inverted
        return Violation(f"{what}, first {self._who(index)}", self._unstable()) if what else None

    def _unbalanced(self, now: Diagnostics) -> Violation | None:
        """Compare energy and momentum with those at the start plus external work and impulse."""
        given = self.external.given(self.clock, now.middle - self.first.middle)
        given = given.and_more(self._free.given() - self._pushed)
        turnover = max(
            self.balance.turnover,
            now.energy,
            abs(given.work),
            ROUNDING[self.model.precision] * given.turned,
        )
        gained = now.energy - self.first.energy - given.work
        moved = max(self.balance.moved, self._momentum_scale(now), given.moved)
        stopped = self._pairs.impulse() - self._stopped
        moved = max(moved, float(np.linalg.norm(stopped)))
        missing = now.momentum - self.first.momentum - given.impulse - stopped
        momentum_gain = float(np.linalg.norm(missing)) / moved if moved > 0 else 0.0
        problem = self._gained(gained, turnover) or self._drifted(momentum_gain)
        if problem is None:
            trembles = self.balance.trembles
            self.balance = Balance(turnover, moved, gained / turnover, momentum_gain, trembles)
        return problem

    def _gained(self, energy: float, turnover: float) -> Violation | None:
        """The violation for spurious energy; rounding in a stiff body counts only once it shows."""
        if energy <= ENERGY_GAIN * turnover:
            return None
        faded = FADING[self.model.precision] * self.clock.substeps
        if energy <= ENERGY_GAIN * self._strained(min(faded, UNSEEN)):
            self.balance.trembles = max(self.balance.trembles, energy / turnover)
            return None
        index = int(energies(self.model, self.state).argmax())
        who = f"most of all its energy is in {self._who(index)}"
        rounded = energy <= self._strained(faded)
        what = f"{energy / turnover:.0%} of its energy came from nowhere, {who}"
        return Violation(what, ROUNDED if rounded else self._unstable())

    def _drifted(self, fraction: float) -> Violation | None:
        """The violation for spurious momentum."""
        if fraction <= MOMENTUM_GAIN[self.model.precision]:
            return None
        index = int(speeds(self.state).argmax())
        what = (
            f"{fraction:.2%} of its momentum came from nowhere, the fastest is {self._who(index)}"
        )
        return Violation(what, ROUNDED if self.model.precision == "float32" else self._unstable())

    def _unstable(self) -> tuple[str, ...]:
        """Causes of an unstable run: the substep, and if it was violent, also what made it so."""
        violent = self.min_J < SQUEEZED or self.clock.stable().limiter in ("speed", "gradient")
        return ("substep", "law", "push") if violent else ("substep",)

    def _strained(self, strain: float) -> float:
        """Elastic energy of the whole body at this strain [J]."""
        stiffest = max(m.density * m.wave_speed() ** 2 for m in self.model.materials)
        volume = float(np.sum(self.model.volume.numpy(), dtype=np.float64))
        return stiffest * volume * strain**2

    def _momentum_scale(self, now: Diagnostics) -> float:
        """The sum of all momenta if they pointed the same way [kg m/s]."""
        return math.sqrt(2 * self.model.total_mass * now.kinetic)

    def _who(self, index: int) -> str:
        """A particle in words."""
        return diagnosis.particle(self.model, self.state, index)

    def _look(self) -> Diagnostics:
        return Diagnostics.of(self.model, self.state, self.clock)
