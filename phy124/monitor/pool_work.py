"""PoolWork: sums the work of a uniform acceleration on a liquid and on the bodies in the liquid.

The impulse of walls on the liquid is known only at the end of a step, so a sum over substeps would
count the weight of the liquid as if nothing carried it. The work is summed once per step of the
liquid.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.monitor.external_work import Exchange, Sums
from phy124.monitor.liquid_work import StepWork
from phy124.monitor.observer import Observer
from phy124.mpm import Clock


class PoolWork(StepWork):
    """External impulse and work on a liquid and the bodies in it."""

    def begin(self, momentum: Sums) -> None:
        """Start a frame: measure the motion."""
        super().begin(momentum)
        if self.by_step:
            self._dry = self._middle_of_bodies()

    def total(self, clock: Clock, way: Sums) -> Exchange:
        """Return the external impulse and work (`ExternalWork.total`)."""
        total = super().total(clock, way)
        if not self.by_step:
            return total
        # The sums extend to the time of the positions; bodies' velocities are half a substep older.
        late = clock.last_dt / 2 * self._mass_of_bodies() * self._acceleration()
        return total._replace(impulse=total.impulse - late)

    def _add_step(self) -> None:
        super()._add_step()
        before, now = self._dry, self._middle_of_bodies()
        # For the bodies, the acceleration is the mean over the step.
        mean = (self._before.pull + self._acceleration()) / 2
        impulse = self._wet.clock.last_dt * self._mass_of_bodies() * mean
        self._add(impulse, float(mean @ (now - before)))
        self._dry = now

    def _middle_of_bodies(self) -> NDArray[np.float64]:
        """Return the sum of mass times position over the bodies [3], kg m."""
        bodies = self._pool.bodies.motions()
        return sum((body.mass * body.centre for body in bodies), np.zeros(3))

    def _mass_of_bodies(self) -> float:
        return self._model.total_mass - self._wet.model.total_mass

    def _acceleration(self) -> NDArray[np.float64]:
        """Return the uniform acceleration [3] in the last substep, m/s^2."""
        values: NDArray[Any] = self._tracks.values.numpy()
        return values[0, :3].astype(np.float64)


class MixedWork(PoolWork):
    """External impulse and work on a liquid and particle bodies.

    The liquid's solver sums the work of forces on the liquid.
    """

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which then sums the impulse and work of forces."""
        super().bind(solver, observers)
        self.follow_pushes(solver.liquid)
