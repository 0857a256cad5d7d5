"""Sand and snow: materials that hold together only under pressure, or until they break."""

from typing import Any

import warp as wp

from phy124.kernels.elastic import (
    fixed_corotated,
    fixed_corotated_energy,
    fixed_corotated_modulus,
)
from phy124.kernels.hencky import log_strain
from phy124.kernels.spectral import eigenvalues, from_double, to_double, with_values
from phy124.kernels.symmetric import deviator, exponential, gram

HARDEST = wp.constant(4.0)
"""Greatest exponent of snow's hardening: at most e^4 = 55 times stiffer than fresh."""


@wp.func
def drucker_prager(F: Any, h: Any, theta: Any, dt: Any):
    """Cone of no cohesion (Klar et al. 2016, sec. 7) with volume correction (Tampubolon 2017).

    theta = (mu, lam, alpha), alpha = sqrt(2/3) 2 sin phi / (3 - sin phi). h[0] >= 0 is the log
    volume gained while loose, which must close before grains carry pressure again.
    """
    zero = type(theta[0])(0.0)
    third = type(theta[0])(1.0) / type(theta[0])(3.0)
    e = log_strain(F)
    change = wp.trace(e)
    volume = change + h[0]
    if volume >= zero:
        return exponential(-e) * F, wp.vector(volume, h[1])
    dev = deviator(e)
    size = wp.sqrt(wp.ddot(dev, dev))
    bulk = type(zero)(3.0) * theta[1] / (type(zero)(2.0) * theta[0]) + type(zero)(1.0)
    flow = wp.max(size + bulk * volume * theta[2], zero)
    if flow == zero and h[0] == zero:
        return F, h
    gap = h[0] * third * wp.identity(3, dtype=type(zero))
    back = gap
    if flow > zero:
        back = gap - (flow / size) * dev
    return exponential(back) * F, wp.vector(zero, h[1])


@wp.func
def snow_hardening(h: Any, theta: Any):
    """exp(xi (1 - Jp)), theta = (mu, lam, least, most, xi), h[0] = Jp - 1."""
    s = theta[4]
    return wp.exp(wp.clamp(-s * h[0], -type(s)(HARDEST), type(s)(HARDEST)))


@wp.func
def snow_energy(F: Any, h: Any, theta: Any):
    """Fixed corotated, stiffer the more it was compressed (Stomakhin et al. 2013, eq. 1)."""
    return snow_hardening(h, theta) * fixed_corotated_energy(F, h, theta)


@wp.func
def snow(F: Any, C: Any, h: Any, theta: Any):
    """Kirchhoff stress of `snow_energy` at fixed Jp."""
    return snow_hardening(h, theta) * fixed_corotated(F, C, h, theta)


@wp.func
def snow_modulus(F: Any, h: Any, theta: Any):
    """Fixed corotated, scaled by the hardening."""
    return snow_hardening(h, theta) * fixed_corotated_modulus(F, h, theta)


@wp.func
def clamp_share(at: wp.float64, least: wp.float64, most: wp.float64) -> wp.float64:
    """Clamped stretch over stretch, for a squared stretch."""
    stretch = wp.sqrt(wp.max(at, wp.float64(1.0e-12)))
    return wp.clamp(stretch, least, most) / stretch


@wp.func
def snow_return(F: Any, h: Any, theta: Any, dt: Any):
    """Stretches clamped to [least, most], what is cut off goes to Jp (eqs. 9 and 10 there).

    Bounds of the eigenvalues of F F^T that need no root settle most elastic particles.
    """
    s = F[0, 0]
    b = gram(F)
    middle = wp.trace(b) / type(s)(3.0)
    dev = deviator(b)
    spread = wp.sqrt(type(s)(2.0) / type(s)(3.0) * wp.ddot(dev, dev))
    if middle - spread >= theta[2] * theta[2] and middle + spread <= theta[3] * theta[3]:
        return F, h
    wide = to_double(F)
    squared = wide * wp.transpose(wide)
    at = eigenvalues(squared)
    least = wp.float64(theta[2])
    most = wp.float64(theta[3])
    f = wp.vec3d(
        clamp_share(at[0], least, most),
        clamp_share(at[1], least, most),
        clamp_share(at[2], least, most),
    )
    cut = with_values(squared, at, f)
    volume = (type(s)(1.0) + h[0]) / type(s)(f[0] * f[1] * f[2])
    return from_double(cut * wide, s), wp.vector(volume - type(s)(1.0), h[1])
