"""Handles fast compression by an artificial viscosity, which needs shorter substeps.

The viscosity (phy124/kernels/lattice/stress.py, `make_shock`) spreads a shock over a few cells. The
viscosity acts while opposite sides of a cell approach each other fast (`largest_calm_rate`). The
rate of compression alone does not indicate a shock: if a crease squeezes a few points flat, even
slow motions have a high rate of compression.
"""

import math
from collections.abc import Sequence

from phy124.materials.base import Material
from phy124.mpm.clock import Clock
from phy124.mpm.stage import Named
from phy124.mpm.timestep import CELLS_PER_STEP, Extremes, Substep, decay

FAST = 0.25
"""The artificial viscosity acts if the closing rate of a cell exceeds this, relative to the speed
of sound divided by the side of a cell. With a value of 0.25, points penetrate walls by up to 0.36
cells if an undamped block is pressed to a fifth of its height. With a value of 0.6, the points
would penetrate walls by up to 0.66 cells.
"""
LEAST = 0.1
"""Largest compression of a point in a substep while the artificial viscosity acts. The artificial
viscosity grows with the rate of compression, so it is stable up to a fixed compression per substep.
With a largest compression of 0.2, cells would invert in impacts at ten times the speed of sound.
"""
IMPACT = 0.3
"""Distance per substep [cells] above which a wall may squeeze a point too much."""
UNSEEN = 0.6
"""Longest distance that a point may move before its velocity is measured again [cells]. At a wall,
several short substeps without a measurement squeeze a point as much as one long substep.
"""
FORGET = 4
"""Factor by which the measured frequency and closing rate decay faster than in the particle solver.
Both values depend on a few points that are squeezed only for a short time.
"""
COLLAPSED = 1e-6
"""Smallest valid length of a substep, relative to the substep of the undeformed body."""
STALLED = 1000
"""A run is unstable if this number of substeps together is shorter than one substep at rest."""


class LatticeClock(Clock):
    """The clock of bodies on lattices."""

    kept = (*Clock.kept, "closing", "lasting", "seen", "solid")

    calm = math.inf
    """The artificial viscosity acts if the closing rate of a cell exceeds this [1/s]."""
    shocked = 0
    """Number of substeps in which the artificial viscosity acted."""
    closing = lasting = 0.0
    """Largest closing rates of cells [1/s]: the last measured rate, and the recent maximum, which
    decays slowly.
    """
    seen = 0.0
    """Time of the last measurement of velocities [s]."""
    solid = 0.0
    """Largest speed of a freely moving solid [m/s]."""
    _marked = (0, 0.0)
    """Number of substeps and time [s] at the last check of the run's progress."""

    @property
    def _rate(self) -> float:
        """Largest recent rate of compression [1/s].

        The rate decays slowly after a measurement, because substeps of alternating length would
        amplify vibrations.
        """
        return max(self.extremes.gradient, self.strain_rate)

    @property
    def in_shock(self) -> bool:
        """Whether the artificial viscosity acts."""
        return max(self.closing, self.lasting) > self.calm

    def limit_by(self, extremes: Extremes, *, complete: bool, acceleration: float = 0.0) -> None:
        """Use measured values as limits, as in `Clock`; `closing` must be set before."""
        self.lasting = max(self.closing, decay(self.lasting, FORGET * self.since_measured))
        super().limit_by(extremes, complete=complete, acceleration=acceleration)

    def stable(self) -> Substep:
        """Return the longest stable substep in the current state."""
        limit = super().stable()
        if limit.dt * self.solid > CELLS_PER_STEP * self.dx:
            limit = Substep(CELLS_PER_STEP * self.dx / self.solid, "speed")
        if self.in_shock and limit.dt * self._rate > LEAST:
            return Substep(LEAST / self._rate, "gradient")
        return limit

    def may_crush(self, speed: float, drift: float) -> bool:
        """Return whether the motion must be measured again before a substep of length `drift` [s].

        `speed` is the largest speed relative to a wall [m/s].
        """
        way = speed * (self.time + drift - self.seen)
        return self.in_shock or speed * drift > IMPACT * self.dx or way > UNSEEN * self.dx

    def mark(self) -> None:
        """Check the progress of the run from the present time on."""
        self._marked = self.substeps, self.time

    def stalls(self, usual: float) -> bool:
        """Return whether the last `STALLED` substeps together are shorter than one substep at rest.

        The length of a substep at rest is `usual` [s].
        """
        taken, elapsed = self.substeps - self._marked[0], self.time - self._marked[1]
        if 0 <= taken < STALLED and elapsed >= 0:
            return False
        self.mark()
        return taken >= STALLED and 0 <= elapsed < usual


def largest_calm_rate(materials: Sequence[Material], dx: float, softened: float = 1.0) -> float:
    """Return the closing rate [1/s] above which the artificial viscosity acts; cells have the side
    `dx` [m], and Young's moduli are `softened` times those of the materials.

    Up to the rate eta / (rho dx^2), the damping eta of the materials causes more pressure than the
    artificial viscosity.
    """
    sound = math.sqrt(softened) * max(material.wave_speed() for material in materials)
    damped = min(1 / (8 * material.viscous_limit(dx)) for material in materials)
    return max(FAST * sound / dx, damped)


def in_shock_only(clock: LatticeClock, recorded: Sequence[Named]) -> list[Named]:
    """Return kernel launches that run only while the artificial viscosity acts."""

    def launch() -> None:
        if clock.in_shock:
            for _, each in recorded:
                each()

    return [("shock", launch)]
