"""PoolWork: sums the work of a uniform acceleration on a liquid and on the bodies in the liquid.

The impulse of walls on the liquid is known only at the end of a step, so a sum over substeps would
count the weight of the liquid as if nothing carried it. The work is summed once per step of the
liquid.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.work import IMPULSE, MOVED, TURNED, WORK
from phy124.monitor.external_work import UNIFORM, Exchange, ExternalWork
from phy124.monitor.observer import Observer
from phy124.mpm import Clock, Model, Stage, State
from phy124.mpm.tracks import Tracks


class PoolMotion(NamedTuple):
    """Motion of the liquid and the bodies after a step of the liquid."""

    momentum: NDArray[np.float64]
    """Momentum of the liquid after the step [3], kg m/s."""
    wet: NDArray[np.float64]
    """Sum of mass times position over the liquid [3], kg m."""
    dry: NDArray[np.float64]
    """Sum of mass times position over the bodies [3], kg m."""
    pull: NDArray[np.float64]
    """Uniform acceleration of the liquid during the step [3], m/s^2."""


class PoolWork(ExternalWork):
    """External impulse and work on a liquid and the bodies in it."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return no stages; impulse and work are summed after steps of the liquid."""
        super().attach(model, state, tracks)
        return []

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, and follow its steps."""
        super().bind(solver, observers)
        self.follow_steps(solver)

    def follow_steps(self, solver: Any) -> None:
        """Sum impulse and work after each step of the liquid from now on."""
        self._pool = solver
        solver.liquid.follower = self._add_step

    def begin(self, momentum: NDArray[np.float64]) -> None:
        """Start a frame: measure the motion."""
        if self.by_momentum:
            self._before = self._measure()

    def total(
        self, clock: Clock, way: NDArray[np.float64], momentum: NDArray[np.float64]
    ) -> Exchange:
        """Return the external impulse and work (`ExternalWork.total`)."""
        total = super().total(clock, way, momentum)
        if not self.by_momentum:
            return total
        # The sums extend to the time of the positions; bodies' velocities are half a substep older.
        mass = self._model.total_mass - self._pool.liquid.model.total_mass
        late = clock.last_dt / 2 * mass * self._acceleration()
        return total._replace(impulse=total.impulse - late)

    def _add_step(self) -> None:
        if not self.by_momentum:
            return
        liquid, before, now = self._pool.liquid, self._before, self._measure()
        kick, drift, a = liquid.kick, liquid.clock.last_dt, now.pull
        # The energy at the time of the positions follows from the last acceleration. If the
        # acceleration changes, so does this energy.
        changed = (kick - drift / 2) * float((a - before.pull) @ before.momentum)
        wet = float(a @ (now.wet - before.wet)) + changed
        # For the bodies, the acceleration is the mean over the step.
        mean = (a + self._acceleration()) / 2
        work = float(mean @ (now.dry - before.dry))
        mass = liquid.model.total_mass
        bodies = drift * (self._model.total_mass - mass) * mean
        sums = self._closed[UNIFORM].copy()
        for impulse, done in ((kick * mass * a, wet), (bodies, work)):
            sums[IMPULSE : IMPULSE + 3] += impulse
            sums[[WORK, MOVED, TURNED]] += np.array([done, np.linalg.norm(impulse), abs(done)])
        self._closed[UNIFORM], self._before = sums, now

    def _measure(self) -> PoolMotion:
        liquid, bodies = self._pool.liquid, self._pool.bodies.motions()
        wet = self._pool.clock.wet()
        dry = sum((body.mass * body.centre for body in bodies), np.zeros(3))
        return PoolMotion(wet.momentum, wet.mass * wet.centre, dry, liquid.clock.pull)

    def _acceleration(self) -> NDArray[np.float64]:
        """Return the uniform acceleration [3] in the last substep, m/s^2."""
        values: NDArray[Any] = self._tracks.values.numpy()
        return values[0, :3].astype(np.float64)
