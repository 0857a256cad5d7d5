"""LiquidWork: sums the work of a uniform acceleration on a liquid with projected pressure.

The work is the acceleration times the displacement of the liquid's centre of mass in each step.
Work computed from the sum of impulses would add up the errors in the walls' impulses: the liquid in
a still tank would seem to sink and to lose potential energy.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.work import IMPULSE, MOVED, TURNED, WORK
from phy124.liquid.rigid import Moments
from phy124.monitor.external_work import UNIFORM, ExternalWork, MeanWork, Sums
from phy124.monitor.observer import Observer
from phy124.mpm import Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.runtime.weakly import weakly


class LiquidMotion(NamedTuple):
    """Motion of the liquid after a step."""

    momentum: NDArray[np.float64]
    """Momentum [3], kg m/s."""
    middle: NDArray[np.float64]
    """Sum of mass times position [3], kg m."""
    pull: NDArray[np.float64]
    """Uniform acceleration during the step [3], m/s^2."""


class StepWork(ExternalWork):
    """Sums impulse and work of a varying uniform acceleration once per step of the liquid."""

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
        self._moments = Moments(self._wet.model, [slice(0, len(self._wet.model))])
        self._wet.follower = weakly(self._follow)

    @property
    def _wet(self) -> Any:
        """The liquid's solver; it is not stored, because its bodies may refer to this observer."""
        return getattr(self._pool, "liquid", self._pool)

    def begin(self, momentum: Sums) -> None:
        """Start a frame: measure the motion."""
        if self.by_step:
            self._before = self._measure()

    def _follow(self) -> None:
        if self.by_step:
            self._add_step()

    def _add_step(self) -> None:
        """Add the impulse and work of the last step."""
        liquid, before, now = self._wet, self._before, self._measure()
        kick, drift, a = liquid.kick, liquid.clock.last_dt, now.pull
        # The energy at the time of the positions follows from the last acceleration. If the
        # acceleration changes, so does this energy.
        changed = (kick - drift / 2) * float((a - before.pull) @ before.momentum)
        work = float(a @ (now.middle - before.middle)) + changed
        self._add(kick * liquid.model.total_mass * a, work)
        self._before = now

    def _add(self, impulse: Sums, work: float) -> None:
        sums = self._closed[UNIFORM].copy()
        sums[IMPULSE : IMPULSE + 3] += impulse
        sums[[WORK, MOVED, TURNED]] += np.array([work, np.linalg.norm(impulse), abs(work)])
        self._closed[UNIFORM] = sums

    def _measure(self) -> LiquidMotion:
        state = self._wet.state
        wet = self._moments.read(state.x, state.v, state.C)[0]
        return LiquidMotion(wet.momentum, wet.mass * wet.centre, self._wet.clock.pull)


class LiquidWork(StepWork, MeanWork):
    """External impulse and work on a liquid, also with freely moving solids in it."""
