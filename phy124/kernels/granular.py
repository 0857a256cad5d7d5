"""Laws of sand, which has no cohesion, and snow, which coheres until it fractures."""

from typing import Any

import warp as wp

from phy124.kernels.elastic import fixed_corotated, fixed_corotated_energy, fixed_corotated_modulus
from phy124.kernels.hencky import log_strain
from phy124.kernels.spectral import (
    deviator,
    eigenvalues,
    exponential,
    from_double,
    gram,
    to_double,
    with_values,
)

HARDEST = wp.constant(4.0)
"""Largest exponent of snow's hardening; the stiffness grows at most by a factor e^4 = 55."""
LOOSEST = wp.constant(1.0e6)
"""Upper limit of Jp; without it, Jp of scattered snow would overflow."""


@wp.func
def drucker_prager(F: Any, h: Any, theta: Any, dt: Any):
    """Project F onto the Drucker-Prager cone without cohesion (Klar et al. 2016, sec. 7; Tampubolon
    2017).

    Tampubolon's volume correction is included. theta = (mu, lam, alpha), alpha = sqrt(2/3) 2 sin
    phi / (3 - sin phi). h[0] >= 0 is the logarithm of the volume that loose grains have gained. The
    grains carry pressure again only after they have lost this volume.
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
    """Return exp(xi (1 - Jp)); theta = (mu, lam, smallest, largest, xi), h[0] = Jp - 1."""
    s = theta[4]
    return wp.exp(wp.clamp(-s * h[0], -type(s)(HARDEST), type(s)(HARDEST)))


@wp.func
def snow_energy(F: Any, h: Any, theta: Any):
    """Return the fixed corotated energy times the hardening (Stomakhin et al. 2013, eq. 1)."""
    return snow_hardening(h, theta) * fixed_corotated_energy(F, h, theta)


@wp.func
def snow(F: Any, C: Any, h: Any, theta: Any):
    """Return the Kirchhoff stress that derives from `snow_energy` at fixed Jp."""
    return snow_hardening(h, theta) * fixed_corotated(F, C, h, theta)


@wp.func
def snow_modulus(F: Any, h: Any, theta: Any):
    """Return the modulus of the fixed corotated law times the hardening."""
    return snow_hardening(h, theta) * fixed_corotated_modulus(F, h, theta)


@wp.func
def clamp_stretches(s: wp.vec3d, minimum: wp.float64, maximum: wp.float64) -> wp.vec3d:
    """Return the stretches clamped to a range."""
    return wp.vec3d(
        wp.clamp(s[0], minimum, maximum),
        wp.clamp(s[1], minimum, maximum),
        wp.clamp(s[2], minimum, maximum),
    )


@wp.func
def stretch_energy(s: wp.vec3d, side: wp.float64, mu: wp.float64, lam: wp.float64) -> wp.float64:
    """Return `fixed_corotated_energy` for three stretches; `side` is -1 if the smallest stretch is
    inverted.
    """
    unit = wp.float64(1.0)
    d = wp.vec3d(s[0] - unit, s[1] - unit, side * s[2] - unit)
    j1 = side * s[0] * s[1] * s[2] - unit
    return mu * wp.dot(d, d) + lam / wp.float64(2.0) * j1 * j1


@wp.func
def snow_return(F: Any, h: Any, theta: Any, dt: Any):
    """Limit stretches to [smallest, largest]; the excess changes Jp (Stomakhin 2013, eqs. 9, 10).

    The strain `largest - 1` at which a particle breaks differs from the material's by the fraction
    h[1]. Stretches and hardening do not change if clamping would increase the energy, because snow
    with a Poisson's ratio near 1/2 would otherwise gain energy by fracture. Under pressure, a
    stretch therefore causes no fracture. For most elastic particles, bounds of the eigenvalues of
    F F^T already show that no stretch needs clamping.
    """
    s = F[0, 0]
    unit = type(s)(1.0)
    largest = unit + (theta[3] - unit) * (unit + h[1])
    b = gram(F)
    middle = wp.trace(b) / type(s)(3.0)
    dev = deviator(b)
    spread = wp.sqrt(type(s)(2.0) / type(s)(3.0) * wp.ddot(dev, dev))
    if middle - spread >= theta[2] * theta[2] and middle + spread <= largest * largest:
        return F, h
    wide = to_double(F)
    squared = wide * wp.transpose(wide)
    at = eigenvalues(squared)
    tiny = wp.float64(1.0e-12)
    trial = wp.vec3d(
        wp.sqrt(wp.max(at[0], tiny)), wp.sqrt(wp.max(at[1], tiny)), wp.sqrt(wp.max(at[2], tiny))
    )
    kept = clamp_stretches(trial, wp.float64(theta[2]), wp.float64(largest))
    f = wp.cw_div(kept, trial)
    volume = (unit + h[0]) / type(s)(f[0] * f[1] * f[2])
    after = wp.vector(wp.min(volume, type(s)(LOOSEST)) - unit, h[1])
    side = wp.float64(1.0)
    if wp.determinant(F) < type(s)(0.0):
        side = -side
    mu = wp.float64(theta[0])
    lam = wp.float64(theta[1])
    gain = wp.float64(snow_hardening(after, theta)) * stretch_energy(kept, side, mu, lam)
    if gain > wp.float64(snow_hardening(h, theta)) * stretch_energy(trial, side, mu, lam):
        return F, h
    return from_double(with_values(squared, at, f) * wide, s), after
