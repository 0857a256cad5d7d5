"""Plasticity in terms of Hencky strain: return mappings project the elastic F onto a yield surface.

The mappings change only e = log V: the new F is exp(e_new - e) F. Yield limits are norms of the
deviatoric Kirchhoff stress: sqrt(2/3) sigma_Y for a uniaxial yield stress sigma_Y.
"""

from typing import Any

import warp as wp

from phy124.kernels.hencky import log_strain
from phy124.kernels.spectral import deviator, exponential


@wp.func
def von_mises(F: Any, h: Any, theta: Any, dt: Any):
    """Project F by a radial return with linear hardening or softening (Simo, Hughes 1998, box 3.1).

    theta = (mu, lam, limit, slope, minimum): the limit changes by `slope` per unit of plastic
    strain, and is at least `minimum`. If the limit decreases faster than the stress (slope <= -2
    mu), the stress drops to `minimum`. h[0] is the accumulated plastic strain, the sum of |d e_p|.
    """
    zero = type(theta[0])(0.0)
    shear = type(theta[0])(2.0) * theta[0]
    dev = deviator(log_strain(F))
    size = wp.sqrt(wp.ddot(dev, dev))
    limit = wp.max(theta[2] + theta[3] * h[0], theta[4])
    excess = shear * size - limit
    if not excess > zero:
        return F, h
    tangent = shear + theta[3]
    flow = excess / tangent
    if not tangent > zero or limit + theta[3] * flow < theta[4]:
        flow = (shear * size - theta[4]) / shear
    return exponential((-flow / size) * dev) * F, wp.vector(h[0] + flow, h[1])


@wp.func
def remaining_fraction(log_k: Any, m: Any):
    """Return the root r in (0, 1] of r + k r^m = 1, k >= 0 and m >= 1, by Newton's method."""
    unit = type(log_k)(1.0)
    r = wp.exp(wp.min(-log_k / m, type(log_k)(0.0)))
    if log_k > type(log_k)(40.0):
        return r
    k = wp.exp(log_k)
    for _ in range(5):
        p = k * wp.pow(r, m - unit)
        r -= (r + p * r - unit) / (unit + m * p)
    return r


@wp.func
def herschel_bulkley(F: Any, h: Any, theta: Any, dt: Any):
    """Project F by viscoplastic flow (Yue et al. 2015): stress above the limit decays gradually.

    The step is backward Euler of d|s|/dt = -2 mu (x / eta)^(1/n), x = |s| - limit; theta = (mu,
    lam, limit, eta [Pa s^n], n). h[0] is the accumulated plastic strain.
    """
    zero = type(theta[0])(0.0)
    unit = type(theta[0])(1.0)
    shear = type(theta[0])(2.0) * theta[0]
    dev = deviator(log_strain(F))
    size = wp.sqrt(wp.ddot(dev, dev))
    excess = shear * size - theta[2]
    if not excess > zero:
        return F, h
    m = unit / theta[4]
    log_rate = wp.log(shear * dt / excess) + m * wp.log(excess / theta[3])
    flow = excess * (unit - remaining_fraction(log_rate, m)) / shear
    return exponential((-flow / size) * dev) * F, wp.vector(h[0] + flow, h[1])
