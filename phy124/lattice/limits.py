"""Limits: measures the limits of a lattice's substep, and decides when to measure them again."""

import math

from phy124.lattice.crew import Crew
from phy124.lattice.meetings import Meetings
from phy124.lattice.shock import COLLAPSED, FORGET, STALLED, LatticeClock
from phy124.lattice.solids import Solids
from phy124.lattice.spectrum import Spectrum
from phy124.lattice.walls import Walls
from phy124.lattice.workers import MEASURE
from phy124.mpm.grid import Unstable
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.rejection import StepRejection
from phy124.mpm.runner import Runner
from phy124.mpm.timestep import MEASURE_EVERY, STRAIN_PER_STEP
from phy124.mpm.workers import run_timed

SLOWEST = 16
"""Largest number of substeps between two measurements of the limits."""
STRAIN = 0.25
"""Strain after which the bodies' largest frequency is measured again. If the frequency is steady,
twice this strain is allowed.
"""
WAY = 0.25
"""Largest motion of a point between two measurements of its distance from walls [cells]."""
TRAVEL = 3.0
"""Approach of points to walls after which the distances from walls are measured again [cells]."""
VIOLENT = 0.35
"""If the strain per substep exceeds this, the limits are measured in every substep."""


class Limits(Kept):
    """Limits the substeps of a lattice solver by measured values."""

    kept = ("measured", "probing", "_strain", "_probed")

    def __init__(
        self,
        model: Model,
        clock: LatticeClock,
        crew: Crew,
        runner: Runner,
        spectrum: Spectrum,
        free: Solids,
    ) -> None:
        self._dx, self._clock, self._crew, self._runner = model.dx, clock, crew, runner
        self._spectrum, self._free = spectrum, free
        self._timings = crew.workers[0].timings
        self.substep_at_rest = clock.cfl * spectrum.substep_at_rest
        """Length of a substep of the undeformed bodies [s]."""
        self.softened = 1.0
        """Current factor on the initial stiffness of all materials."""
        self.probing = False
        """Whether the next substep measures the largest frequency of the bodies."""
        self._strain, self._probed = math.inf, 0
        """Bound of the strain since the largest frequency was measured, and the number of substeps
        before this measurement.
        """
        self._travel = 0.0
        """Bound of the motion since the distances from walls were measured [m]."""
        self.measured = 0.0
        """Time of the last measurement of the limits [s]."""

    def bind(self, walls: Walls, meetings: Meetings, rejection: StepRejection) -> None:
        """Set the walls, the contacts between bodies, and the bounds of forces."""
        self._walls, self._meetings, self._rejection = walls, meetings, rejection

    def measure_if_due(self) -> bool:
        """Measure the limits of the substep if necessary; return whether they were measured."""
        due = self._clock.due
        if due:
            self._measure()
        return due

    def shorten(self, drift: float) -> float:
        """Return `drift` [s], shortened so that walls do not squeeze any point too much."""
        clock = self._clock
        self._runner.join()
        run_timed(self._timings, "measure", lambda: self._runner.complete(MEASURE))
        # The maxima are not reset, because they are read again at the end of the substep if the
        # stress kernels measure them.
        speed, gradient, clock.closing = self._crew.maxima()
        clock.extremes = clock.extremes._replace(speed=speed, gradient=gradient)
        clock.seen = clock.time
        longest = STRAIN_PER_STEP / max(gradient, 1e-30)
        # If the stress kernels measure the maxima, they also do so in the next substeps.
        if longest < drift or clock.in_shock or not self._crew.measuring:
            clock.expire()
        return min(drift, longest)

    def fastest(self) -> float:
        """Return the largest speed [m/s] of all points, walls and freely moving solids."""
        return max(self._clock.extremes.speed, self._rejection.wall, self._free.fastest())

    def _measure(self) -> None:
        clock = self._clock
        if not self._crew.measuring or not clock.substeps:
            run_timed(self._timings, "measure", lambda: self._runner.complete(MEASURE))
            self.read(clock.time - self.measured)
            self.measured = clock.seen = clock.time
        measured = clock.extremes._replace(stiffness=self._spectrum.stiffen(self.softened))
        clock.solid = self._free.fastest()
        passed = FORGET * clock.since_complete
        clock.limit_by(measured.after(clock.extremes, substeps=passed), complete=True)
        clock.interval = self.interval()
        # Until the next measurement, the strain grows at the present rate.
        ahead = clock.interval * clock.extremes.gradient * clock.stable().dt
        late = clock.substeps + clock.interval > self._probed + SLOWEST
        enough = 2 * STRAIN if self._spectrum.steady else STRAIN
        self.probing = late or not self._strain + ahead < enough
        if self._travel > TRAVEL * self._dx:
            self.look()
        self._list_near()
        run_timed(self._timings, "meetings", lambda: self._meetings.follow(self._step()))
        run_timed(self._timings, "free", lambda: self._free.list_near(self._step(), self._ahead()))

    def read(self, elapsed: float) -> None:
        """Limit substeps by the largest speed and strain rate; raise Unstable if a body collapsed.

        The last measurement was `elapsed` seconds ago.
        """
        clock = self._clock
        speed, gradient, clock.closing = self._crew.take_maxima()
        self._refuse_collapse()
        extremes, pull = clock.extremes, self._rejection.acceleration
        fastest = max(speed, extremes.speed) + self._rejection.wall
        way = elapsed * (fastest + elapsed * pull)
        self._travel, self._meetings.way = self._travel + way, self._meetings.way + way
        # The rate is relative to the current size, so it grows while a point is squeezed.
        gradient /= max(0.1, 1 - gradient * clock.last_dt)
        self._strain += gradient * elapsed
        clock.extremes = extremes._replace(speed=speed, gradient=gradient)
        if gradient * elapsed > VIOLENT:
            clock.expire()

    def _refuse_collapse(self) -> None:
        """Raise Unstable if a body collapsed, or if a body or solid is too fast for any substep.

        The next attempt then takes substeps of half the length at rest, because a run with the
        current short substeps would never end.
        """
        clock = self._clock
        lost = self._crew.lost()
        usual = min(self.substep_at_rest, clock.ceiling)
        inverted = lost or clock.stable().dt < COLLAPSED * usual
        if not inverted and not clock.stalls(usual):
            return
        limit = clock.stable()
        if limit.limiter == "speed" and not lost:
            speed = max(clock.extremes.speed, clock.solid)
            what = f"at {speed:.2g} m/s, a substep would last {limit.dt:.1e} s"
            raise Unstable(f"the motion is too fast: {what}", self.substep_at_rest)
        what = f"{STALLED} substeps together lasted less than one substep of the undeformed body"
        if inverted:
            what = "it turned inside out" + (f" ({lost} points)" if lost else "")
        raise Unstable(f"the body was squeezed so fast that {what}", self.substep_at_rest)

    def measure_frequency(self) -> None:
        """Measure the bodies' largest frequency after the forces are summed, before they act."""
        clock = self._clock
        self.probing, self._strain, self._probed = False, 0.0, clock.substeps
        self._runner.join()
        run_timed(self._timings, "frequency", self._spectrum.follow)
        extremes = clock.extremes
        stiffness = max(self._spectrum.stiffness, extremes.stiffness)
        clock.extremes = extremes._replace(stiffness=stiffness)

    def look(self) -> None:
        """Measure the distances of all surface points from the walls."""
        self._travel, self.measured = 0.0, self._clock.time
        run_timed(self._timings, "near", self._walls.look)
        self._list_near()

    def _list_near(self) -> None:
        self._walls.list_near(self._travel + max(2 * WAY * self._dx, self._ahead()), self._step())

    def _ahead(self) -> float:
        """Return the largest approach [m] of a point to a wall before the next measurement."""
        step = self._step()
        # The walls are still at their positions of the previous substep.
        return (self._clock.interval + 1) * step if math.isfinite(step) else 0.0

    def _step(self) -> float:
        """Return the largest distance [m] by which a point may approach a wall in a substep."""
        clock = self._clock
        dt = clock.stable().dt
        speed = clock.extremes.speed + max(self._rejection.wall, self._free.fastest())
        return speed * dt if math.isfinite(dt) else math.inf

    def interval(self) -> int:
        """Return the number of substeps until the limits must be measured."""
        clock, dx = self._clock, self._dx
        dt = clock.stable().dt
        if not math.isfinite(dt):
            return 1
        speed = self.fastest()
        steps = [float(SLOWEST)]
        steps.append(STRAIN / max(clock.extremes.gradient * dt, 1e-9))
        steps.append(WAY * dx / max(speed * dt, 1e-30))
        steps.append(math.sqrt(2 * WAY * dx / max(self._rejection.acceleration, 1e-30)) / dt)
        violent = clock.in_shock or clock.extremes.gradient * dt > VIOLENT
        return 1 if violent else max(MEASURE_EVERY, int(min(steps)))
