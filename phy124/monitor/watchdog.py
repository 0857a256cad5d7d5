"""The watchdog: once per frame, is the state sound and does the balance of the run add up?

A violation is a sentence. What is checked, with the limits below: every number is finite; no
more than a few particles are turned inside out; volume ratios stay in range; momentum changes by
what forces and walls gave; energy does not grow beyond the work they did (explicit MPM only loses
energy, so more means that the run is exploding). Which particle it is and what to change is
looked for only then (phy124/monitor/diagnosis.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import diagnose
from phy124.kernels.diagnostics import SUMS, make_totals
from phy124.kernels.reduction import shared_out
from phy124.monitor import diagnosis
from phy124.monitor.external_work import ExternalWork, total_mass
from phy124.monitor.tearing import Tearing

if TYPE_CHECKING:
    from phy124.mpm import Solver

INSIDE_OUT = 0.01
"""Share of particles turned inside out from which the result is wrong."""
FEW = 2
"""So many are never too many; they are reset before the next frame, and counted."""
SOUND_J = (1e-5, 1e6)
"""Volume ratios that a law can work with; a particle beyond is reset and counted."""
SOUND_F = 1e3
"""Greatest norm of a sound deformation gradient."""
NARROWEST = 1e-5
"""Least share of the smallest stretch in the greatest: beyond, rounding decides the sign of J."""
HEAL_AFTER = 1.0
"""Strain after which deformations are looked at again: |C| dt, summed over the substeps."""
ENERGY_GAIN = 0.25
"""Energy from nowhere that is tolerated, as a share of the greatest energy turned over.

Of 6,500 random scenes one in a hundred reached 0.7 %, the worst 13 % (two particles whose velocity
is set in every substep); an unstable run passes any limit within a few frames.
"""
MOMENTUM_GAIN = {"float32": 1e-3, "float64": 1e-6}
"""Momentum from nowhere that is tolerated, as a share of all momentum moved."""
ROUNDING = {"float32": 1e-5, "float64": 1e-12}
"""Share of all work, given and taken, that rounding may lose."""
QUIET = 1e-9
"""Energies below this share of volume times stiffness are rounding."""
FRAGILE = ("fixed_corotated", "plasticine")
"""Laws that may stay flat after an impact: their energy at J = 0 is finite."""
COLLAPSE = 0.8
"""Speed of impact, in speeds of sound, from which fragile laws come close to J = 0."""
GREATEST_TOTAL = 1e6
"""Norm of F_total that flowing material is held to; what is seen of it stops growing at 4."""
UNSEEN = 3e-4
"""Strain that no picture shows: 0.1 of 300 pixels."""
FADING = {"float32": 2e-9, "float64": 4e-18}
"""Strain that rounding of F may leave per substep.

F grows by dt C F; where a stiff body turns slowly that is less than the last digit of F, and what
rounding leaves out strains it. Measured: 3e-10 per substep in float32, 7e-10 with half the
`accuracy.cfl`, however far from the origin; energies are squares, of which a quarter is tolerated.
"""
FAR = 2**31 - 1
MEMORY = (
    "reset", "_first_reset", "_fastest", "energy_gain", "momentum_gain", "least_J", "greatest_J",
    "_begun", "turnover", "moved", "_trembles",
)  # fmt: skip
"""Numbers that a paused run keeps."""
VECTORS = ("momentum", "angular", "middle")


FAST = ("push", "cells")
ROUNDED = ("precision",)
"""Causes of violations (`phy124.remedies`): of a run too fast for its window, of rounding."""
SQUEEZED = 0.5
"""Volume ratio below which the law and the push may be to blame for what is unstable."""


class Violation(NamedTuple):
    """What is wrong with a frame."""

    what: str
    """Half a sentence."""
    causes: tuple[str, ...]
    """What may be at fault, for `phy124.remedies`, the likeliest first."""


@dataclass(frozen=True)
class Balance:
    """What a state adds up to."""

    momentum: NDArray[np.float64]
    """[3], kg m/s."""
    angular: NDArray[np.float64]
    """Angular momentum about the origin [3], kg m^2/s."""
    kinetic: float
    """J, when the last substep kicked: half a substep before the positions."""
    elastic: float
    """J."""
    lag: float
    """What the kinetic energy will have changed by at the time of the elastic one, J."""
    middle: NDArray[np.float64]
    """Mass times position [3], kg m."""
    least_J: float
    """Least volume ratio."""
    greatest_J: float
    """Greatest volume ratio."""
    broken: int
    """Particles that are not finite."""
    inverted: int
    """Particles turned inside out."""
    first: tuple[int, int]
    """The lowest index of a broken and of an inverted particle."""

    def data(self) -> dict[str, Any]:
        """As plain data."""
        arrays = {name: getattr(self, name).tolist() for name in VECTORS}
        return {**vars(self), **arrays}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Balance:
        """From plain data."""
        arrays = {name: np.array(data[name]) for name in VECTORS}
        return cls(**{**data, **arrays, "first": tuple(data["first"])})

    @property
    def energy(self) -> float:
        """Kinetic and elastic energy of one instant, J.

        m/2 v(t - dt/2) . v(t + dt/2) + psi(t), which leapfrog conserves exactly in a vibration.
        """
        return self.kinetic + self.elastic + self.lag


def weigh(solver: Solver) -> Balance:
    """Add up the state of a solver."""
    device = solver.device
    sums = wp.zeros(SUMS, dtype=wp.float64, device=device)
    spread = wp.array([-math.inf, -math.inf], dtype=wp.float64, device=device)
    counts = wp.zeros(2, dtype=int, device=device)
    first = wp.array([FAR, FAR], dtype=int, device=device)
    s = solver.state
    for group in solver.groups:
        part = slice(group.start, group.stop)
        history = s.history[part] if len(s.history) else s.history
        threads, *share = shared_out(group.stop - group.start, device)
        wp.launch(
            make_totals(group.law, solver.real),
            threads,
            inputs=[
                *share, group.theta, solver.mass[part], solver.volume[part], solver.dx, group.start,
                s.x[part], s.v[part], s.C[part], s.F[part], history,
            ],
            outputs=[sums, spread, counts, first],
            device=device,
        )  # fmt: skip
    total: NDArray[Any] = sums.numpy()
    ends: NDArray[Any] = spread.numpy()
    found: NDArray[Any] = counts.numpy()
    index: NDArray[Any] = first.numpy()
    return Balance(
        momentum=total[:3], angular=total[3:6], kinetic=float(total[6]), elastic=float(total[7]),
        lag=-solver.last_dt / 2 * float(total[11]), middle=total[8:11],
        least_J=-float(ends[0]), greatest_J=float(ends[1]),
        broken=int(found[0]), inverted=int(found[1]), first=(int(index[0]), int(index[1])),
    )  # fmt: skip


def sound_speed(material: Any) -> float:
    """Speed of a pressure wave in an elastic material, sqrt((lambda + 2 mu) / rho) [m/s]."""
    mu, lam = material.lame
    return math.sqrt((lam + 2 * mu) / material.density)


class Watchdog:
    """Follows one run, whose solver got its forces and boundaries through `external`."""

    def __init__(self, solver: Solver, external: ExternalWork, *, balance: bool = True) -> None:
        self.solver, self.external, self._balance = solver, external, balance
        self.first = self.last = weigh(solver)
        self.mass = total_mass(solver)
        self.tearing = Tearing(solver)
        self.reset, self._first_reset = 0, FAR
        """Particles whose deformation was reset so far."""
        self._found = wp.zeros(2, dtype=int, device=solver.device)
        self._heal, self._limit = self._record_heal(), self._record_limit()
        self._fastest = 0.0
        self.energy_gain = self.momentum_gain = 0.0
        self._trembles = 0.0
        """Share of the energy that rounding made, if that was more than elsewhere is tolerated."""
        self.least_J, self.greatest_J = self.first.least_J, self.first.greatest_J
        self._begun = False

    def before(self) -> None:
        """Before a frame: reset deformations that no law can work with."""
        self._found.assign([self.reset, self._first_reset])
        self._heal.launch()
        self._count_resets()
        if not self._begun:
            self._begin()

    def _record_heal(self) -> wp.Launch:
        s, limits = self.solver, [*SOUND_J, SOUND_F, NARROWEST]
        outputs = [s.state.F, s.state.C, self._found]
        launch = s.record(diagnose.make_reset(s.real), len(s.rest), limits, outputs)
        return cast("wp.Launch", launch)

    def _record_limit(self) -> wp.Launch | None:
        s = self.solver
        inputs, count = [GREATEST_TOTAL, s.state.F], len(s.state.total)
        return s.record(diagnose.make_limit_total(s.real), count, inputs, [s.state.total])

    def _tend(self) -> None:
        """Reset deformations that no law can work with, and hold F_total to its greatest size."""
        self._heal.launch()
        if self._limit is not None:
            self._limit.launch()

    def _count_resets(self) -> None:
        self.reset, self._first_reset = self._found.numpy().tolist()

    def _begin(self) -> None:
        """The balance begins with the first frame that is followed: a run may be a resumed one."""
        self.first = self.last = weigh(self.solver)
        self.turnover = max(self.first.energy, self._quiet())
        self.moved = math.sqrt(2 * self.mass * self.turnover)
        if self._balance:
            self.external.open(self.solver)
        self._begun = True

    def memory(self) -> dict[str, Any]:
        """What `recall` needs, as plain data."""
        memory = {name: getattr(self, name) for name in MEMORY if hasattr(self, name)}
        balances = {name: getattr(self, name).data() for name in ("first", "last")}
        return {**memory, **balances, "tearing": self.tearing.memory()}

    def recall(self, memory: dict[str, Any], books: dict[str, Any]) -> None:
        """Go on as when `memory` was taken; `books` are the external work's."""
        for name in MEMORY:
            if name in memory:
                setattr(self, name, memory[name])
        self.first, self.last = (Balance.from_data(memory[name]) for name in ("first", "last"))
        self.tearing.recall(memory["tearing"])
        if self._begun and self._balance:
            self.external.open(self.solver)
            self.external.recall(books)

    def after(self) -> Violation | None:
        """After a frame: what is wrong with it, or None."""
        now = weigh(self.solver)
        problem = self._unsound(now) or (self._unbalanced(now) if self._balance else None)
        if problem is None:
            self._count_resets()
            if self._limit is not None:
                self._limit.launch()
            self.tearing.look()
            self.last = now
            self.least_J = min(self.least_J, now.least_J)
            self.greatest_J = max(self.greatest_J, now.greatest_J)
        return problem

    def follow(self) -> Callable[[], None]:
        """What to call after each substep of the next frame, or after some of them."""
        s = self.solver
        if self._balance:
            self.external.begin(s, self.last.momentum)
        strain, seen = 0.0, s.time

        def after() -> None:
            nonlocal strain, seen
            self._fastest = max(self._fastest, s.extremes.speed)
            strain += s.extremes.gradient * (s.time - seen)
            seen = s.time
            if strain > HEAL_AFTER:
                self._tend()
                strain = 0.0

        return after

    def blame(self, problem: str) -> Violation:
        """The solver gave up: what it said, with the particle."""
        s = self.solver
        index = diagnosis.first_broken(s)
        if index is not None:
            return Violation(f"{problem}, first {self._who(index)}", self._unstable())
        index = int(diagnosis.speeds(s).argmax())
        return Violation(f"{problem}; the fastest is {self._who(index)}", FAST)

    def notes(self) -> list[str]:
        """What the user should know about how the run went."""
        notes, s = [], self.solver
        if self.reset:
            notes.append(
                f"{self.reset} times a particle was deformed beyond what a law can describe and "
                f"was given its shape at rest, first {self._who(self._first_reset)}. A gentler "
                "push or a stiffer material would keep it whole."
            )
        if s.outliers.most:
            notes.append(
                f"{s.outliers.most} particles flew out of the simulated space and went on along "
                "their parabolas, without contact."
            )
        laws = {m.device_law.name: m for m in s.materials}
        fragile = {name: m for name, m in laws.items() if name.startswith(FRAGILE)}
        for name, material in sorted(fragile.items()):
            mach = self._fastest / sound_speed(material)
            if mach > COLLAPSE:
                notes.append(
                    f"The law {name} moved at {mach:.1f} times its speed of sound. Where it hits "
                    f"something at more than {COLLAPSE} times, it may stay squeezed flat without "
                    "any other sign; neo_hookean would not."
                )
        if self._trembles:
            notes.append(
                f"It moves so slowly for its stiffness that rounding made {self._trembles:.0%} of "
                f"its energy: a trembling of less than {UNSEEN:g} of its size, which no picture "
                "shows. With accuracy.precision = float64 there is none."
            )
        torn = self.tearing.note()
        return [*notes, torn] if torn else notes

    def report(self) -> dict[str, Any]:
        """What was found, for the report of the run."""
        return {
            "energy_gain": self.energy_gain if self._balance else None,
            "momentum_gain": self.momentum_gain if self._balance else None,
            "least_J": self.least_J,
            "greatest_J": self.greatest_J,
            "inside_out": self.last.inverted,
            "reset": self.reset,
            "ballistic": self.solver.outliers.most,
            "tearing": self.tearing.report(),
        }

    def _unsound(self, now: Balance) -> Violation | None:
        what, index = "", 0
        if now.broken:
            what, index = f"{now.broken} particles are no longer numbers", now.first[0]
        elif now.inverted > max(FEW, INSIDE_OUT * len(self.solver.rest)):
            what, index = f"{now.inverted} particles are turned inside out", now.first[1]
        return Violation(f"{what}, first {self._who(index)}", self._unstable()) if what else None

    def _unbalanced(self, now: Balance) -> Violation | None:
        """Compare what is there with what was there at first and what was given since."""
        given = self.external.total(self.solver, now.middle - self.first.middle)
        turnover = max(
            self.turnover, now.energy, abs(given.work), ROUNDING[self._precision] * given.turned
        )
        gained = now.energy - self.first.energy - given.work
        moved = max(self.moved, self._momentum_scale(now), given.moved)
        missing = now.momentum - self.first.momentum - given.impulse
        momentum_gain = float(np.linalg.norm(missing)) / moved if moved > 0 else 0.0
        problem = self._gained(gained, turnover) or self._drifted(momentum_gain)
        if problem is None:
            self.turnover, self.moved = turnover, moved
            self.energy_gain, self.momentum_gain = gained / turnover, momentum_gain
        return problem

    def _gained(self, energy: float, turnover: float) -> Violation | None:
        """Energy from nowhere; what rounding makes of a stiff body is none until it shows."""
        if energy <= ENERGY_GAIN * turnover:
            return None
        faded = FADING[self._precision] * self.solver.substeps
        if energy <= ENERGY_GAIN * self._strained(min(faded, UNSEEN)):
            self._trembles = max(self._trembles, energy / turnover)
            return None
        index = int(diagnosis.energies(self.solver).argmax())
        who = f"most of all its energy is in {self._who(index)}"
        rounded = energy <= self._strained(faded)
        what = f"{energy / turnover:.0%} of its energy came from nowhere, {who}"
        return Violation(what, ROUNDED if rounded else self._unstable())

    def _drifted(self, share: float) -> Violation | None:
        """Momentum from nowhere."""
        if share <= MOMENTUM_GAIN[self._precision]:
            return None
        index = int(diagnosis.speeds(self.solver).argmax())
        what = f"{share:.2%} of its momentum came from nowhere, the fastest is {self._who(index)}"
        return Violation(what, ROUNDED if self._precision == "float32" else self._unstable())

    def _unstable(self) -> tuple[str, ...]:
        """Causes of an unstable run: the substep; where it was violent, also what made it so."""
        violent = self.least_J < SQUEEZED or self.solver.substep().limiter in ("speed", "gradient")
        return ("substep", "law", "push") if violent else ("substep",)

    @property
    def _precision(self) -> str:
        return "float32" if self.solver.real is wp.float32 else "float64"

    def _strained(self, strain: float) -> float:
        """Energy of the whole body strained so much [J]."""
        stiffest = max(m.density * m.wave_speed() ** 2 for m in self.solver.materials)
        volume = float(np.sum(self.solver.volume.numpy(), dtype=np.float64))
        return stiffest * volume * strain**2

    def _momentum_scale(self, balance: Balance) -> float:
        """What all momenta would add up to if they pointed the same way [kg m/s]."""
        return math.sqrt(2 * self.mass * balance.kinetic)

    def _quiet(self) -> float:
        """Energy that is no more than rounding [J]."""
        return self._strained(math.sqrt(QUIET))

    def _who(self, index: int) -> str:
        """A particle in words."""
        return diagnosis.describe(self.solver, index)
