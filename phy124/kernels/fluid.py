"""Weakly compressible fluid: pressure from the volume ratio, viscosity from the velocity gradient.

The elastic F of a fluid is j I with j = J^(1/3). The history variable is J about one relaxation
time ago. The fluid is stiffer for faster changes, and the energy of this additional stiffness is
dissipated (Mandelstam and Leontovich 1937).
"""

from typing import Any

import warp as wp

MIN_J = wp.constant(1.0e-4)
"""Volume ratio of a fluid below which the pressure no longer rises."""
TAIT_J = wp.constant(0.8)
"""Below this volume ratio, J p is linear in log J. Impacts faster than a quarter of the speed of
sound can compress a few particles below this volume ratio. The full pressure of these particles
would shorten the substeps of all particles.
"""


@wp.func
def squeeze(F: Any):
    """Return max(J, `TAIT_J`), and the logarithm of the compression beyond `TAIT_J`."""
    J = wp.max(wp.determinant(F), type(F[0, 0])(MIN_J))
    bounded = wp.max(J, type(J)(TAIT_J))
    return bounded, wp.log(J / bounded)


@wp.func
def weight_of_pressure(J: Any, theta: Any):
    """Return J p, p = K / gamma (J^-gamma - 1) (Cole 1948; Becker 2007, eq. 7)."""
    return J * theta[0] / theta[1] * (wp.pow(J, -theta[1]) - type(J)(1.0))


@wp.func
def hardness(J: Any, theta: Any):
    """Return d(-J p) / d log J = K / gamma ((gamma - 1) J^(1 - gamma) + J)."""
    less = theta[1] - type(J)(1.0)
    return theta[0] / theta[1] * (less * wp.pow(J, -less) + J)


@wp.func
def lag(F: Any, h: Any):
    """Return log(J / J'), where J' is the volume ratio about one relaxation time ago."""
    J = wp.max(wp.determinant(F), type(F[0, 0])(MIN_J))
    return wp.log(J / wp.max(h[0], type(J)(MIN_J)))


@wp.func
def tait_energy(F: Any, h: Any, theta: Any):
    """Return K / gamma (J + J^(1 - gamma) / (gamma - 1) - gamma / (gamma - 1)) + K' lag^2 / 2.

    Here lag = log(J / J') (see `lag`). The energy is zero at J = 1.
    """
    J, more = squeeze(F)
    less = theta[1] - type(J)(1.0)
    late = lag(F, h)
    psi = theta[0] / theta[1] * (J + (wp.pow(J, -less) - theta[1]) / less)
    psi += theta[4] * late * late * type(J)(0.5)
    return psi + more * (hardness(J, theta) * more * type(J)(0.5) - weight_of_pressure(J, theta))


@wp.func
def tait(F: Any, C: Any, h: Any, theta: Any):
    """Return the Kirchhoff stress -J p I + 2 j eta dev(sym C) + zeta tr C I + K' log(J / J') I.

    theta = (K [Pa], gamma, eta [Pa s], zeta [Pa s], K' [Pa], 1 / relaxation time [1/s]). A negative
    pressure acts as cohesion. Here j = min(J, 1), so that the viscosity per unit mass, which limits
    the substep, does not change when the fluid expands. zeta damps sound where the fluid is
    compressed. J' is the volume ratio about one relaxation time ago (`lag`).
    """
    unit = type(theta[0])(1.0)
    J, more = squeeze(F)
    viscous = wp.min(J, unit) * theta[2]
    rate = wp.trace(C)
    mean = viscous * type(unit)(2.0) / type(unit)(3.0) * rate
    mean += weight_of_pressure(J, theta) - hardness(J, theta) * more
    if J < unit:
        mean -= theta[3] * rate
    mean -= theta[4] * lag(F, h)
    return viscous * (C + wp.transpose(C)) - mean * wp.identity(3, dtype=type(unit))


@wp.func
def tait_modulus(F: Any, h: Any, theta: Any):
    """Return 3 d(-J p) / d log J + 3 K'; the first term is constant below `TAIT_J`."""
    J, _ = squeeze(F)
    return type(J)(3.0) * (hardness(J, theta) + theta[4])


@wp.func
def isotropic(F: Any, h: Any, theta: Any, dt: Any):
    """Return the F and the history of a fluid after a substep: F is replaced by (tr F / 3) I.

    The trace gives the change of volume to first order. With the determinant, a vortex would
    expand: for a rotation, det(I + dt W) exceeds 1 by (dt omega)^2.
    """
    unit = type(dt)(1.0)
    j = wp.max(wp.trace(F) / type(dt)(3.0), type(dt)(0.0))
    fraction = unit - wp.exp(-dt * theta[5])
    late = h[0] + fraction * (j * j * j - h[0])
    return j * wp.identity(3, dtype=type(dt)), wp.vector(late, h[1])
