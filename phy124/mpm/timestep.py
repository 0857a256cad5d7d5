"""Computes the stable substep of explicit MLS-MPM, and the limit that determines it.

dt = min(k dx sqrt(rho0 / A), 0.5 dx / |v|, 0.4 / |C|), where A is the largest eigenvalue of d tau /
d ln sigma, |v| is the largest speed, and |C| is the largest velocity gradient. The first limit
follows from an isolated particle. With affine gradients, this particle is a harmonic oscillator
with omega^2 = 4 A / (rho0 dx^2). See `ELASTIC_LIMIT` and docs/design/physics.md.

If the length of the substep followed A in phase with a vibration, the vibration would gain energy.
Leapfrog with equal substeps conserves energy, so the assumed A decays slowly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.measure import GRADIENT, HIGH, LOW, SPEED, STIFFNESS

CFL = 0.75
"""Length of a substep as a fraction of the elastic limit."""
ELASTIC_LIMIT = {"affine": 1.0, "spline": math.sqrt(0.5)}
"""Elastic limit in units of dx sqrt(rho0 / A), for each kind of velocity gradient.

A strain e of an isolated particle changes its velocity gradient by -g A e dt / (rho0 dx^2). For
affine gradients, g is 4. For gradients of the weights, g = sum w'^2 / w is at most 6, halfway
between two nodes, but C changes as for g = 4. Such a particle is stable up to sqrt(2 / (g - 2)).
"""
CELLS_PER_STEP = 0.5
"""Largest distance that a particle moves in one substep [cells]."""
STRAIN_PER_STEP = 0.4
"""Largest |C| dt of a substep; below 1, an element cannot become inverted in one substep."""
MEMORY = 0.95
"""Factor by which the assumed stiffness decays in `MEASURE_EVERY` substeps."""
TRAVEL = 2
"""Largest distance that particles may move between two measurements of their positions [cells]."""
MEASURE_EVERY = 4
"""Number of substeps between two measurements of the particles that is safe for any motion."""


class Extremes(NamedTuple):
    """The largest values among all particles; these values limit the substep."""

    speed: float
    """Largest speed |v| of a particle [m/s]."""
    gradient: float
    """Largest Frobenius norm of a particle's velocity gradient C [1/s]."""
    stiffness: float
    """Largest A / rho0 of a particle [m^2/s^2]: modulus of the law divided by rest density."""

    def after(self, before: Extremes, speed: float = 0.0, *, substeps: int) -> Extremes:
        """Return these largest values, but with lower bounds for speed and stiffness.

        The speed is at least `speed` [m/s]. The stiffness is at least the stiffness of `before`,
        decayed over `substeps`.
        """
        stiffness = max(self.stiffness, decay(before.stiffness, substeps))
        return self._replace(stiffness=stiffness, speed=max(self.speed, speed))


class Maxima(NamedTuple):
    """Largest values and bounding box of some particles, as measured on the device."""

    extremes: Extremes
    lower: NDArray[np.float64]
    """Lowest corner of the particles' bounding box [3], m."""
    upper: NDArray[np.float64]
    """Highest corner of the particles' bounding box [3], m."""

    @classmethod
    def of(cls, row: NDArray[np.float64]) -> Maxima:
        """Convert an array with the layout of `phy124.kernels.measure` to maxima."""
        speed, gradient, stiffness = row[[SPEED, GRADIENT, STIFFNESS]].tolist()
        return cls(Extremes(speed, gradient, stiffness), -row[LOW : LOW + 3], row[HIGH : HIGH + 3])

    @property
    def corners(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner of the particles' bounding box [m]."""
        return self.lower, self.upper


class Substep(NamedTuple):
    """Length of a substep, and the limit that determines it."""

    dt: float
    """Length of the substep [s]."""
    limiter: str
    """Name of the limit: elastic, speed, gradient, viscous, user or retry."""


def stable_substep(
    extremes: Extremes,
    dx: float,
    *,
    cfl: float = CFL,
    elastic_limit: float = 1.0,
    ceiling: float = math.inf,
    viscous: float = math.inf,
    ceiling_name: str = "user",
) -> Substep:
    """Return the longest stable substep, and the limit that determines it.

    Args:
        extremes: The largest speed, gradient and stiffness of the particles.
        dx: Grid spacing [m].
        cfl: Fraction of the elastic limit to use.
        elastic_limit: The elastic limit in units of dx sqrt(rho0 / A); see `ELASTIC_LIMIT`.
        ceiling: Longest substep allowed [s].
        viscous: Longest substep that viscosity allows [s].
        ceiling_name: Name of the limit `ceiling`.
    """
    limits = {
        "elastic": _divide(cfl * elastic_limit * dx, math.sqrt(extremes.stiffness)),
        "speed": _divide(CELLS_PER_STEP * dx, extremes.speed),
        "gradient": _divide(STRAIN_PER_STEP, extremes.gradient),
        "viscous": viscous,
        ceiling_name: ceiling,
    }
    limiter = min(limits, key=limits.__getitem__)
    return Substep(limits[limiter], limiter)


def decay(value: float, substeps: int) -> float:
    """Return the decayed value that is assumed `substeps` substeps after a measurement."""
    return MEMORY ** (substeps / MEASURE_EVERY) * value


def beside_elastic(cfl: float) -> float:
    """Return the stable fraction of the viscous limit for substeps of `cfl` times the elastic
    limit.

    An oscillator with omega dt = 2 cfl and damping gamma dt, both integrated explicitly, is stable
    while (omega dt)^2 <= 4 - 2 gamma dt. The condition is the same for both elastic limits of
    `ELASTIC_LIMIT`.
    """
    return min(1.0, 2 - 2 * cfl * cfl)


def beside_rpic(cfl: float) -> float:
    """Return the stable fraction of the elastic limit if RPIC damps the strain rate in C.

    An oscillator that keeps the fraction s of its velocity in each substep is stable while (omega
    dt)^2 <= 2 + 2 s; in the worst case s is 0.
    """
    return cfl * math.sqrt(0.5)


def _divide(a: float, b: float) -> float:
    return a / b if b > 0 else math.inf
