"""Viscosity: a Newtonian stress in addition to the elastic one (Kelvin 1865, Voigt 1892).

The laws here are those of `elastic` and `hencky` with eta [Pa s] after their parameters. A material
without viscosity uses the plain laws.
"""

from typing import Any

import warp as wp

from phy124.kernels.elastic import fixed_corotated, neo_hookean
from phy124.kernels.hencky import hencky


@wp.func
def newtonian(F: Any, C: Any, eta: Any):
    """J eta (C + C^T): Kirchhoff stress of sigma = 2 eta D, with D the rate of strain.

    For an inverted element it is zero, so that it never adds energy; for one larger than at rest, J
    counts as 1, since the limit of the substep assumes that.
    """
    strength = wp.clamp(wp.determinant(F), type(eta)(0.0), type(eta)(1.0)) * eta
    return strength * (C + wp.transpose(C))


@wp.func
def neo_hookean_damped(F: Any, C: Any, h: Any, theta: Any):
    """Neo-Hookean with viscosity; theta = (mu, lam, eta)."""
    return neo_hookean(F, C, h, theta) + newtonian(F, C, theta[2])


@wp.func
def fixed_corotated_damped(F: Any, C: Any, h: Any, theta: Any):
    """Fixed corotated with viscosity; theta = (mu, lam, eta)."""
    return fixed_corotated(F, C, h, theta) + newtonian(F, C, theta[2])


@wp.func
def hencky_damped(F: Any, C: Any, h: Any, theta: Any):
    """Hencky with viscosity; theta = (mu, lam, eta)."""
    return hencky(F, C, h, theta) + newtonian(F, C, theta[2])
