"""Fast compression: an artificial viscosity, and the shorter substeps that it needs.

An impact near the speed of sound would squeeze the first layer of points flat before the stress of
the next layer stops it. The viscosity (phy124/kernels/lattice/stress.py, `make_shock`) spreads such
a shock over a few cells. It acts while material is compressed faster than `FAST` c / dx.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from phy124.mpm.clock import Clock
from phy124.mpm.stage import Named
from phy124.mpm.timestep import Substep

FAST = 0.6
"""Rate of compression above which the viscosity acts, relative to c / dx."""
LEAST = 0.1
"""Largest compression in a substep while it acts. The viscosity grows with the rate, so that its
stable substep is a fixed compression; with 0.2, impacts at ten times the speed of sound invert.
"""
IMPACT = 0.3
"""Way in a substep above which a point that meets a wall may be squeezed too much [cells]."""
COLLAPSED = 1e-6
"""Length of a substep, relative to that at rest, below which the motion is no longer sound."""


class LatticeClock(Clock):
    """The clock of bodies on lattices."""

    sound = math.inf
    """Largest speed of a pressure wave at rest [m/s]."""
    shocked = 0
    """Number of substeps with artificial viscosity."""

    @property
    def _rate(self) -> float:
        """Largest recent rate of compression [1/s]. It decays slowly after a measurement: substeps
        whose length changes to and fro would feed vibrations.
        """
        return max(self.extremes.gradient, self.strain_rate)

    @property
    def in_shock(self) -> bool:
        """Whether the artificial viscosity acts."""
        return self._rate * self.dx > FAST * self.sound

    def stable(self) -> Substep:
        """Return the longest stable substep in the current state."""
        limit = super().stable()
        if self.in_shock and limit.dt * self._rate > LEAST:
            return Substep(LEAST / self._rate, "gradient")
        return limit

    def may_crush(self, speed: float, drift: float) -> bool:
        """Return whether a substep must be measured before anything moves.

        Args:
            speed: Largest speed relative to a wall [m/s].
            drift: Length of the substep [s].
        """
        return self.in_shock or speed * drift > IMPACT * self.dx


def in_shock_only(clock: LatticeClock, recorded: Sequence[Named]) -> list[Named]:
    """Return launches that are left out unless the artificial viscosity acts."""

    def launch() -> None:
        if clock.in_shock:
            for _, each in recorded:
                each()

    return [("shock", launch)]
