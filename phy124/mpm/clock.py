"""Clock: keeps the time of a run, and chooses the length of the next substep."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.timestep import MEASURE_EVERY, TRAVEL, Extremes, Substep, decay, stable_substep


class Clock(Kept):
    """The time of one run, on the host and on the device."""

    kept = (
        "time",
        "last_dt",
        "substeps",
        "limiters",
        "needed",
        "extremes",
        "strain_rate",
        "interval",
        "since_measured",
        "strain",
        "travel",
        "_last_measured",
        "since_complete",
    )

    def __init__(
        self, model: Model, *, ceiling: float = math.inf, measure_every: int = MEASURE_EVERY
    ) -> None:
        self.dx, self.viscous = model.dx, model.viscous
        self.cfl, self.elastic_limit, self.ceiling = model.cfl, model.elastic_limit, ceiling
        """Substep length as a fraction of the elastic limit; this limit in units of dx sqrt(rho0 /
        A); and the largest allowed length [s].
        """
        self.ceiling_name = "user"
        """Name of the limit `ceiling`: user, or retry while a frame is repeated."""
        self.measure_every = measure_every
        """Number of substeps between two measurements of the particles."""
        self.time, self.substeps, self.last_dt = 0.0, 0, 0.0
        """Current time [s], number of substeps so far, and length of the last substep [s]."""
        self.limiters: dict[str, int] = {}
        """For each limit on the length of substeps, the number of substeps that it determined."""
        self.needed: dict[str, float] = {}
        """Like `limiters`, but before the numbers of substeps are rounded up."""
        self.extremes = self.recent = Extremes(0.0, 0.0, 0.0)
        """The last measured values that limit the length of substeps, and the maxima of these
        values since the host last read them.
        """
        self.strain_rate = 0.0
        """Largest recent velocity gradient |C| [1/s]. The current |C| alone would be zero at the
        turning point of a vibration.
        """
        self.interval = self.since_measured = min(measure_every, MEASURE_EVERY)
        """Number of substeps between two measurements of speeds, and number of substeps since the
        last measurement.
        """
        self.strain = self.travel = math.inf
        """Upper bounds of the strain and the displacement [m] of any particle since the last
        complete measurement; infinite if the next measurement must be complete.
        """
        self._last_measured, self.since_complete = 0.0, 0
        """Time of the last measurement [s], and number of substeps since the last complete
        measurement.
        """
        self.values = wp.zeros(3, dtype=model.real, device=model.device)
        """Array on the device: kick, drift and start time of the current substep [s]."""
        self._shared = self.values.numpy() if model.device == "cpu" else None
        self._limits: tuple[Any, Substep] | None = None

    @property
    def behind(self) -> float:
        """Time by which velocities lag behind positions [s]."""
        return self.last_dt / 2

    @property
    def due(self) -> bool:
        """Whether the limits must be measured before the next substep."""
        return self.since_measured >= self.interval

    def stable(self) -> Substep:
        """Return the longest stable substep in the current state."""
        inputs = (self.extremes, self.cfl, self.ceiling, self.ceiling_name)
        if self._limits is None or self._limits[0] != inputs:
            self._limits = (
                inputs,
                stable_substep(
                    self.extremes,
                    self.dx,
                    cfl=self.cfl,
                    elastic_limit=self.elastic_limit,
                    ceiling=self.ceiling,
                    viscous=self.viscous,
                    ceiling_name=self.ceiling_name,
                ),
            )
        return self._limits[1]

    def lag(self, power: float, momentum: NDArray) -> float:
        """Return the kinetic energy at the time of positions minus that at the time of velocities
        [J].

        `power` is the power of the stress [W]; the momentum is not used here.
        """
        return -self.last_dt / 2 * power

    def expire(self) -> None:
        """Require a complete measurement before the next substep."""
        self.since_measured, self.strain = self.interval, math.inf

    def complete(self, calm_strain: float) -> bool:
        """Return whether the next measurement must include stiffness and positions.

        A strain of more than `calm_strain` changes the stiffness. Particles that move far may leave
        the margin of their window.
        """
        late = self.since_complete + MEASURE_EVERY > self.measure_every
        elapsed = self.time - self._last_measured
        strain = self.strain + elapsed * self.strain_rate
        # Until the next measurement, particles may move the same distance again. If the next
        # interval is longer, they may move the fraction `calm_strain` of a cell.
        travel = elapsed * self.extremes.speed
        ahead = self.travel + travel + max(travel, calm_strain * self.dx)
        return late or strain > calm_strain or ahead > TRAVEL * self.dx

    def limit_by(self, extremes: Extremes, *, complete: bool, acceleration: float = 0.0) -> None:
        """Use the measured values to limit the following substeps.

        Args:
            extremes: The largest values over all particles.
            complete: Whether stiffness and positions were also measured.
            acceleration: Bound of the acceleration by forces since the last measurement [m/s^2].
        """
        elapsed, before = self.time - self._last_measured, self.extremes
        rate = max(extremes.gradient, decay(self.strain_rate, self.since_measured))
        self.strain += elapsed * max(rate, self.strain_rate)
        # Between two measurements, forces may have accelerated particles and then slowed them down
        # again.
        gained = acceleration * elapsed / 2
        self.travel += elapsed * (max(extremes.speed, before.speed) + gained)
        self.strain_rate, self._last_measured, self.since_measured = rate, self.time, 0
        self.extremes = self.recent = extremes
        if complete:
            self.strain, self.travel, self.since_complete = 0.0, 0.0, 0

    def begin(self, kick: float, drift: float) -> None:
        """Write the substep's durations [s] to the device: `kick` for v, and `drift` for x
        and F.
        """
        values = (kick, drift, self.time)
        if self._shared is not None:
            self._shared[:] = values
        else:
            self.values.assign(np.array(values))

    def list_failed(self, dt: float) -> list[tuple[Clock, float]]:
        """Return the clocks to `halve` if a frame is repeated, and the lengths of their last steps
        [s].

        The last substep lasted `dt` [s]; 0: unknown.
        """
        return [(self, dt)]

    @contextmanager
    def halve(self, failed: float) -> Iterator[None]:
        """Limit substeps in this context to half the usual length, and to half of `failed` [s], the
        length of the failed substep (0: unknown).
        """
        usual = self.cfl, self.ceiling, self.measure_every
        self.cfl, self.ceiling = usual[0] / 2, min(usual[1], failed or math.inf) / 2
        self.ceiling_name = "retry"
        self.measure_every = min(usual[2], MEASURE_EVERY)
        try:
            yield
        finally:
            self.cfl, self.ceiling, self.measure_every = usual
            self.ceiling_name = "user"

    def finish(self, drift: float, *, violent: bool = False) -> None:
        """Count a substep of length `drift` [s]; a `violent` substep requests a new measurement."""
        self.time += drift
        self.substeps += 1
        self.since_measured += 1
        self.since_complete += 1
        if violent:
            self.expire()

    def count(self, limiter: str, substeps: int = 1, *, needed: float) -> None:
        """Count substeps whose length was determined by a limit.

        `needed` is the number of substeps before it is rounded up.
        """
        self.limiters[limiter] = self.limiters.get(limiter, 0) + substeps
        self.needed[limiter] = self.needed.get(limiter, 0.0) + needed

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        super().restore(snapshot)
        self.recent = self.extremes
