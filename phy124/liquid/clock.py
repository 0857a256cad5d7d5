"""Keeps the time of a liquid's run, and chooses the length of the steps.

A step is limited by the distance that particles move, and by waves on the surface. The most
restrictive waves are two cells long. Pressure and viscosity are implicit and do not limit a step.
"""

import math

import numpy as np
from numpy.typing import NDArray

from phy124.mpm import Clock, Model
from phy124.mpm.timestep import Extremes, Substep

CELLS = 2.0
"""Largest distance that a particle of the liquid moves in a step [cells]."""
WAVES = 0.5
"""Longest step in units of sqrt(dx / `a`), where dx is the cell size and `a` the acceleration of
the liquid.
"""

RESOLVED = 4.0
"""Smallest number of steps in a vibration period of a body, unless each step contains `AVERAGED`
periods.
"""
AVERAGED = 1.5
"""Smallest number of a body's vibration periods in a step, unless a period contains `RESOLVED`
steps. Between these two limits, the last pressure would amplify the vibrations.
"""
LIGHT_RESOLVED = 8.0
"""Smallest number of steps in a vibration period of a light body."""
LIGHT_AVERAGED = 0.45
"""Smallest number of a light body's vibration periods in a step, unless a period contains
`LIGHT_RESOLVED` steps. Between these two limits, the pressure would deform a light body more than
the liquid can follow. This would create energy.
"""


class LiquidClock(Clock):
    """A clock whose steps satisfy the limits for an incompressible liquid."""

    kept = (*Clock.kept, "pull")

    acceleration = 0.0
    """Upper bound of the acceleration of the liquid by forces [m/s^2]."""
    pull: NDArray[np.float64] = np.zeros(3)
    """Uniform acceleration [3], m/s^2."""
    wall = 0.0
    """Largest speed of a wall in contact with the liquid [m/s]."""
    bodies = 0.0
    """Largest speed of bodies of other materials [m/s]."""
    period = math.inf
    """Shortest vibration period of a body below the liquid [s]."""
    light = math.inf
    """Shortest vibration period of a light body in the liquid [s]."""

    def __init__(self, model: Model, *, ceiling: float = math.inf) -> None:
        """Start the clock of a liquid; viscosity does not limit its steps."""
        super().__init__(model, ceiling=ceiling)
        self.viscous = math.inf

    def stable(self) -> Substep:
        """Return the longest step in the current state."""
        a, speed = self.acceleration, max(self.extremes.speed, self.wall, self.bodies)
        far = CELLS * self.dx
        # Time t in which the fastest particle moves the distance `far`: speed t + a t^2 / 2 = far.
        reach = speed + math.sqrt(speed * speed + 2 * a * far)
        limits = {
            "speed": 2 * far / reach if reach > 0 else math.inf,
            "wave": WAVES * math.sqrt(self.dx / a) if a > 0 else math.inf,
            self.ceiling_name: self.ceiling,
        }
        limiter = min(limits, key=limits.__getitem__)
        return Substep(limits[limiter], limiter)

    def divide(self, rest: float) -> tuple[float, Substep]:
        """Divide the time `rest` [s] into equal steps; return the length [s] of a step, and the
        limit that determines the length.
        """
        limit = self.stable()
        dt = rest / max(1, math.ceil(rest / limit.dt - 1e-9))
        of_wall = self.period, RESOLVED, AVERAGED
        of_light = self.light, LIGHT_RESOLVED, LIGHT_AVERAGED
        for period, resolved, averaged in (of_wall, of_light):
            if period / resolved < dt < averaged * period:
                limit = Substep(period / resolved, "elastic")
                dt = rest / math.ceil(rest / limit.dt)
        return dt, limit

    def lag(self, power: float, momentum: NDArray) -> float:
        """Return the kinetic energy at the time of the positions, minus the kinetic energy at the
        time of the velocities [J].

        `momentum` [3] is in kg m/s; `power` is not used, since a projected liquid has no stress.
        """
        return self.last_dt / 2 * float(self.pull @ momentum)

    def set_speed(self, speed: float) -> None:
        """Set the largest speed of the particles [m/s]."""
        self.extremes = self.recent = Extremes(speed, 0.0, 0.0)
