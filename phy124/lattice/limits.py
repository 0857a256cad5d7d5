"""Limits: measures the limits of a lattice's substep, and decides when to measure them again.

The largest speed and strain rate, the largest frequency, and the distances of points from walls are
measured only every few substeps. The next measurement is due when the strain or the displacements
since the last measurement may have become too large.
"""

from __future__ import annotations

import math
from typing import Any

from phy124.lattice.shock import COLLAPSED, FORGET, STALLED
from phy124.lattice.workers import MEASURE
from phy124.mpm.grid import Unstable
from phy124.mpm.timestep import MEASURE_EVERY, STRAIN_PER_STEP
from phy124.mpm.workers import run_timed

SLOWEST = 16
"""Largest number of substeps between two measurements of the limits."""
STRAIN, WAY = 0.25, 0.25
"""`STRAIN`: largest strain between two measurements of the largest frequency; twice as large while
the frequency is steady. `WAY`: largest displacement of a point [cells] between two measurements of
its distance from walls.
"""
TRAVEL = 3.0
"""Largest approach of points to walls before distances are measured again [cells]."""
VIOLENT = 0.35
"""If strain rate times substep length is larger, the limits are measured before every substep."""


class Limits:
    """Limits the substeps of a lattice solver by measured values."""

    def __init__(self, solver: Any) -> None:
        """Store the solver; nothing is measured yet."""
        self._solver = solver
        self.probing = False
        """Whether the next substep measures the largest frequency."""
        self._strain, self._probed = math.inf, 0
        """Upper bound of the strain since the last measurement of the frequency, and the substep of
        this measurement.
        """
        self._travel = 0.0
        """Upper bound of the displacements of points and walls since points near walls were listed
        [m].
        """
        self.measured = 0.0
        """Time of the last measurement [s]."""

    def measure_if_due(self) -> bool:
        """Measure the limits of the substep if necessary; return whether they were measured."""
        due = self._solver.clock.due
        if due:
            self._measure()
        return due

    def shorten(self, drift: float) -> float:
        """Return a duration of at most `drift` [s] in which no point is squeezed too much."""
        solver, clock = self._solver, self._solver.clock
        solver.runner.join()
        run_timed(solver.timings, "measure", lambda: solver.runner.complete(MEASURE))
        # The maxima are not reset, because the end of the substep also reads them if the stress
        # kernels measure.
        speed, gradient, clock.closing = solver.crew.maxima()
        clock.extremes = clock.extremes._replace(speed=speed, gradient=gradient)
        clock.seen = clock.time
        longest = STRAIN_PER_STEP / max(gradient, 1e-30)
        # If the stress kernels measure, they also do so in the next substeps.
        if longest < drift or clock.in_shock or not solver.crew.measuring:
            clock.expire()
        return min(drift, longest)

    def fastest(self) -> float:
        """Return the largest speed [m/s] of all points, walls and freely moving solids."""
        solver = self._solver
        return max(solver.clock.extremes.speed, solver.rejection.wall, solver.free.fastest())

    def _measure(self) -> None:
        """Measure the limits of the substep; raise Unstable if the body collapsed."""
        solver, clock = self._solver, self._solver.clock
        if not solver.crew.measuring or not clock.substeps:
            run_timed(solver.timings, "measure", lambda: solver.runner.complete(MEASURE))
            self.read(clock.time - self.measured)
            self.measured = clock.seen = clock.time
        measured = clock.extremes._replace(stiffness=solver.spectrum.stiffen(solver.softened))
        passed = FORGET * clock.since_complete
        clock.limit_by(measured.after(clock.extremes, substeps=passed), complete=True)
        clock.interval = self.interval()
        # Until the next measurement, the strain grows at the present rate.
        ahead = clock.interval * clock.extremes.gradient * clock.stable().dt
        late = clock.substeps + clock.interval > self._probed + SLOWEST
        enough = 2 * STRAIN if solver.spectrum.steady else STRAIN
        self.probing = late or not self._strain + ahead < enough
        if self._travel > TRAVEL * solver.model.dx:
            self.look()
        self._list_near()
        run_timed(solver.timings, "meetings", lambda: solver.meetings.follow(self._step()))
        run_timed(solver.timings, "free", lambda: solver.free.list_near(self._step()))

    def read(self, elapsed: float) -> None:
        """Limit substeps by the largest speed and strain rate; raise Unstable if a body collapsed.

        Args:
            elapsed: Time since the last measurement [s].
        """
        solver, clock = self._solver, self._solver.clock
        speed, gradient, clock.closing = solver.crew.take_maxima()
        self._refuse_collapse()
        extremes, pull = clock.extremes, solver.rejection.acceleration
        fastest = max(speed, extremes.speed) + solver.rejection.wall
        way = elapsed * (fastest + elapsed * pull)
        self._travel, solver.meetings.way = self._travel + way, solver.meetings.way + way
        # While the last substep squeezes a point, the rate grows.
        gradient /= max(0.1, 1 - gradient * clock.last_dt)
        self._strain += gradient * elapsed
        clock.extremes = extremes._replace(speed=speed, gradient=gradient)
        if gradient * elapsed > VIOLENT:
            clock.expire()

    def _refuse_collapse(self) -> None:
        """Raise Unstable if a value is not finite, or if substeps have become too short.

        The next attempt then takes substeps of half the length at rest, because a run with the
        current short substeps would never end.
        """
        solver, clock = self._solver, self._solver.clock
        lost = solver.crew.lost()
        usual = min(solver.substep_at_rest, clock.ceiling)
        inverted = lost or clock.stable().dt < COLLAPSED * usual
        if not inverted and not clock.stalls(usual):
            return
        clock.last_dt = solver.substep_at_rest
        what = f"{STALLED} substeps together lasted less than one of the undeformed body"
        if inverted:
            what = "it turned inside out" + (f" ({lost} points)" if lost else "")
        raise Unstable(f"the body was squeezed so fast that {what}")

    def measure_frequency(self) -> None:
        """Measure the largest frequency, after forces are summed and before they act."""
        solver, clock = self._solver, self._solver.clock
        self.probing, self._strain, self._probed = False, 0.0, clock.substeps
        solver.runner.join()
        run_timed(solver.timings, "frequency", solver.spectrum.follow)
        extremes = clock.extremes
        stiffness = max(solver.spectrum.stiffness, extremes.stiffness)
        clock.extremes = extremes._replace(stiffness=stiffness)

    def look(self) -> None:
        """Measure the distances of all surface points from the walls."""
        solver = self._solver
        self._travel, self.measured = 0.0, solver.clock.time
        run_timed(solver.timings, "near", solver.walls.look)
        self._list_near()

    def _list_near(self) -> None:
        """List the surface points that walls may touch before the next measurement."""
        solver = self._solver
        solver.walls.list_near(self._travel + 2 * WAY * solver.model.dx, self._step())

    def _step(self) -> float:
        """Return the largest distance [m] by which a point may approach a wall in a substep."""
        solver, clock = self._solver, self._solver.clock
        dt = clock.stable().dt
        speed = clock.extremes.speed + max(solver.rejection.wall, solver.free.fastest())
        return speed * dt if math.isfinite(dt) else math.inf

    def interval(self) -> int:
        """Return the number of substeps until the limits must be measured."""
        solver, clock, dx = self._solver, self._solver.clock, self._solver.model.dx
        dt = clock.stable().dt
        if not math.isfinite(dt):
            return 1
        speed = self.fastest()
        steps = [float(SLOWEST)]
        steps.append(STRAIN / max(clock.extremes.gradient * dt, 1e-9))
        steps.append(WAY * dx / max(speed * dt, 1e-30))
        steps.append(math.sqrt(2 * WAY * dx / max(solver.rejection.acceleration, 1e-30)) / dt)
        violent = clock.in_shock or clock.extremes.gradient * dt > VIOLENT
        return 1 if violent else max(MEASURE_EVERY, int(min(steps)))

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the state, as plain data."""
        return {
            "measured": self.measured,
            "probing": self.probing,
            "probed": (self._strain, self._probed),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        self._strain, self._probed = snapshot["probed"]
        self.measured, self.probing = snapshot["measured"], snapshot["probing"]
