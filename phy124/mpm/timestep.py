"""The stable substep of explicit MLS-MPM, and which of its limits is in force.

dt = min(k dx sqrt(rho0 / A), 0.5 dx / |v|, 0.4 / |C|): A the largest eigenvalue of
d tau / d ln sigma (an isolated particle is a harmonic oscillator of omega^2 = 4 A / (rho0 dx^2)),
|v| the largest speed, |C| the largest velocity gradient. See docs/design/physics.md.

If the substep followed A up and down in phase with a vibration, it would pump energy into it. A is
therefore forgotten only slowly: leapfrog with substeps of equal length conserves energy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

CFL = 0.75
"""Fraction of the elastic limit that is used."""
CELLS_PER_STEP = 0.5
"""Largest distance that a particle moves in one substep [cells]."""
STRAIN_PER_STEP = 0.4
"""Largest |C| dt; below 1 an element cannot turn inside out."""
MEMORY = 0.95
"""Fraction of an earlier stiffness that still counts `MEASURE_EVERY` substeps later."""
TRAVEL = 2
"""Distance that particles may move before their positions are measured [cells]; the margin of the
grid's window is twice as wide."""
MEASURE_EVERY = 4
"""Substeps between two measurements of the limits that are safe in any motion."""


class Extremes(NamedTuple):
    """The largest values over all particles, which limit the substep."""

    speed: float
    """|v| [m/s]."""
    gradient: float
    """|C|, Frobenius norm [1/s]."""
    stiffness: float
    """A / rho0 [m^2/s^2]."""

    def after(self, before: Extremes, speed: float = 0.0, *, substeps: int) -> Extremes:
        """The same with at least the remembered stiffness and this speed.

        Args:
            before: Those measured `substeps` earlier.
            speed: Largest speed of what is no particle [m/s].
            substeps: Number of substeps since then.
        """
        stiffness = max(self.stiffness, remembered(before.stiffness, substeps))
        return self._replace(stiffness=stiffness, speed=max(self.speed, speed))


class Substep(NamedTuple):
    """A substep and what limits it."""

    dt: float
    """Length [s]."""
    limiter: str
    """elastic, speed, gradient, viscous or user."""


def stable_substep(
    extremes: Extremes,
    dx: float,
    *,
    cfl: float = CFL,
    ceiling: float = math.inf,
    viscous: float = math.inf,
) -> Substep:
    """The longest stable substep.

    Args:
        extremes: The largest speed, gradient and stiffness of the particles.
        dx: Grid spacing [m].
        cfl: Fraction of the elastic limit to use.
        ceiling: Longest substep that the user allows [s].
        viscous: Longest substep that viscosity allows [s].
    """
    limits = {
        "elastic": _divide(cfl * dx, math.sqrt(extremes.stiffness)),
        "speed": _divide(CELLS_PER_STEP * dx, extremes.speed),
        "gradient": _divide(STRAIN_PER_STEP, extremes.gradient),
        "viscous": viscous,
        "user": ceiling,
    }
    limiter = min(limits, key=limits.__getitem__)
    return Substep(limits[limiter], limiter)


def remembered(value: float, substeps: int) -> float:
    """What still counts of a value that was measured some substeps ago."""
    return MEMORY ** (substeps / MEASURE_EVERY) * value


def beside_elastic(cfl: float) -> float:
    """Fraction of the viscous limit that is stable together with `cfl` of the elastic one.

    An oscillator with omega dt = 2 cfl and damping gamma dt, both integrated explicitly, is stable
    while (omega dt)^2 <= 4 - 2 gamma dt.
    """
    return min(1.0, 2 - 2 * cfl * cfl)


def beside_rpic(cfl: float) -> float:
    """What of a fraction `cfl` of the elastic limit is stable where the strain in C is damped.

    An oscillator that keeps the part s of its velocity in each substep is stable while
    (omega dt)^2 <= 2 + 2 s; s is 0 at worst.
    """
    return cfl * math.sqrt(0.5)


def _divide(a: float, b: float) -> float:
    return a / b if b > 0 else math.inf
