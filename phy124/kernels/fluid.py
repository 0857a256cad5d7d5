"""Weakly compressible fluid: pressure of the volume ratio J, viscosity of the velocity gradient.

The elastic F of a fluid is j I with j = J^(1/3): shape is forgotten, only volume is kept.
"""

from typing import Any

import warp as wp

LEAST_J = wp.constant(0.1)
"""Volume ratio below which the pressure no longer rises."""


@wp.func
def tait_energy(F: Any, h: Any, theta: Any):
    """K / gamma (J + J^(1 - gamma) / (gamma - 1) - gamma / (gamma - 1)), zero at J = 1."""
    one = type(theta[0])(1.0)
    J = wp.max(wp.determinant(F), type(one)(LEAST_J))
    less = theta[1] - one
    return theta[0] / theta[1] * (J + (wp.pow(J, -less) - theta[1]) / less)


@wp.func
def tait(F: Any, C: Any, h: Any, theta: Any):
    """-J p I + 2 j eta dev(sym C), p = K / gamma (J^-gamma - 1) (Cole 1948; Becker 2007, eq. 7).

    theta = (K [Pa], gamma, eta [Pa s]); tension is allowed, as cohesion. j = min(J, 1): what has
    flown apart keeps its viscosity per mass, which limits the substep, not that per volume.
    """
    one = type(theta[0])(1.0)
    J = wp.max(wp.determinant(F), type(one)(LEAST_J))
    pressure = theta[0] / theta[1] * (wp.pow(J, -theta[1]) - one)
    viscous = wp.min(J, one) * theta[2]
    mean = viscous * type(one)(2.0) / type(one)(3.0) * wp.trace(C) + J * pressure
    return viscous * (C + wp.transpose(C)) - mean * wp.identity(3, dtype=type(one))


@wp.func
def tait_modulus(F: Any, h: Any, theta: Any):
    """3 d(-J p) / d log J = 3 K / gamma ((gamma - 1) J^(1 - gamma) + J)."""
    one = type(theta[0])(1.0)
    J = wp.max(wp.determinant(F), type(one)(LEAST_J))
    less = theta[1] - one
    return type(one)(3.0) * theta[0] / theta[1] * (less * wp.pow(J, -less) + J)


@wp.func
def isotropic(F: Any, h: Any, theta: Any, dt: Any):
    """tr F / 3 I: with F = (I + dt C) j I this is the volume change without the turn's error.

    det(I + dt W) of a rotation exceeds one by (dt omega)^2, which would let a whirl expand.
    """
    j = wp.max(wp.trace(F) / type(dt)(3.0), type(dt)(0.0))
    return j * wp.identity(3, dtype=type(dt)), h
