"""Viscosity: a Newtonian stress beside the elastic one (Kelvin 1865, Voigt 1892).

The laws here are those of `elastic` and `hencky` with their parameters and eta [Pa s] after them.
A material without friction uses the plain ones, which do not know of it.
"""

from typing import Any

import warp as wp

from phy124.kernels.elastic import fixed_corotated, neo_hookean
from phy124.kernels.hencky import hencky


@wp.func
def newtonian(F: Any, C: Any, eta: Any):
    """J eta (C + C^T): Kirchhoff stress of sigma = 2 eta D, D the rate of strain.

    An element that is inside out has none, so it never gives energy; one that is larger than at
    rest has that of rest, which is what the substep is limited for.
    """
    strength = wp.clamp(wp.determinant(F), type(eta)(0.0), type(eta)(1.0)) * eta
    return strength * (C + wp.transpose(C))


@wp.func
def neo_hookean_damped(F: Any, C: Any, h: Any, theta: Any):
    """Neo-Hookean with friction; theta = (mu, lam, eta)."""
    return neo_hookean(F, C, h, theta) + newtonian(F, C, theta[2])


@wp.func
def fixed_corotated_damped(F: Any, C: Any, h: Any, theta: Any):
    """Fixed corotated with friction; theta = (mu, lam, eta)."""
    return fixed_corotated(F, C, h, theta) + newtonian(F, C, theta[2])


@wp.func
def hencky_damped(F: Any, C: Any, h: Any, theta: Any):
    """Hencky with friction; theta = (mu, lam, eta)."""
    return hencky(F, C, h, theta) + newtonian(F, C, theta[2])
