"""Laws of sand, which has no cohesion, and snow, which coheres until it fractures."""

from typing import Any

import warp as wp

from phy124.kernels.elastic import fixed_corotated, fixed_corotated_energy, fixed_corotated_modulus
from phy124.kernels.hencky import log_strain
from phy124.kernels.spectral import (
    decompose,
    deviator,
    exponential,
    from_double,
    gram,
    interpolant,
    quadratic,
    to_double,
)

HARDEST = wp.constant(4.0)
"""Largest exponent of snow's hardening; the stiffness grows at most by a factor e^4 = 55."""
CLOSE = wp.constant(0.1)
"""Largest |F F^T - I|^2 for which the strain is computed in the precision of F."""
LOOSEST = wp.constant(1.0e6)
"""Upper limit of snow's plastic volume ratio Jp. Without a limit, Jp would overflow in scattered
snow.
"""


@wp.func
def drucker_prager(F: Any, h: Any, theta: Any, dt: Any):
    """Project F onto the Drucker-Prager cone without cohesion (Klar et al. 2016, sec. 7).

    The volume correction of Tampubolon (2017) is included. theta = (mu, lam, alpha), alpha =
    sqrt(2/3) 2 sin phi / (3 - sin phi). h[0] >= 0 is the logarithm of the volume that loose grains
    have gained, and must lose before they carry pressure again.
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
def volume_growth(s: Any):
    """Return the product of the stretches 1 + s, minus 1, without cancellation."""
    pairs = s[0] * s[1] + s[1] * s[2] + s[2] * s[0]
    return s[0] + s[1] + s[2] + pairs + s[0] * s[1] * s[2]


@wp.func
def stretch_energy(s: Any, theta: Any):
    """Return the energy of `fixed_corotated_energy` for the stretches 1 + s."""
    growth = volume_growth(s)
    return theta[0] * wp.dot(s, s) + theta[1] / type(growth)(2.0) * growth * growth


@wp.func
def stretch_of(strain: Any):
    """Return sqrt(1 + strain) - 1 without cancellation.

    The strain is at least -1 + 1e-12, for an element that is compressed to a point.
    """
    unit = type(strain)(1.0)
    least = wp.max(strain, type(strain)(1.0e-12) - unit)
    return least / (unit + wp.sqrt(unit + least))


@wp.func
def limit_stretches(F: Any, strain: Any, h: Any, theta: Any, most: Any):
    """Return F with stretches limited to the range from theta[2] to 1 + `most`, and the history.

    Nothing changes if the limits would increase the energy. `strain` is F F^T - I.
    """
    unit = type(most)(1.0)
    q, p, d, squared, x = decompose(strain)
    trial = wp.vector(stretch_of(q + p * x[0]), stretch_of(q + p * x[1]), stretch_of(q + p * x[2]))
    least = theta[2] - unit
    kept = wp.vector(
        wp.clamp(trial[0], least, most),
        wp.clamp(trial[1], least, most),
        wp.clamp(trial[2], least, most),
    )
    f = wp.cw_div(kept - trial, trial + wp.vector(unit, unit, unit))
    bulk = volume_growth(kept)
    more = (unit + h[0]) * (volume_growth(trial) - bulk) / (unit + bulk)
    after = wp.vector(wp.min(h[0] + more, type(unit)(LOOSEST) - unit), h[1])
    if wp.determinant(F) < type(unit)(0.0):
        trial[2] = -type(unit)(2.0) - trial[2]
        kept[2] = -type(unit)(2.0) - kept[2]
    gain = snow_hardening(after, theta) * stretch_energy(kept, theta)
    if gain > snow_hardening(h, theta) * stretch_energy(trial, theta):
        return F, h
    return F + quadratic(interpolant(x, f), d, squared) * F, after


@wp.func
def is_positive(a: Any):
    """Return whether all eigenvalues of a symmetric matrix are positive (Sylvester)."""
    zero = type(a[0, 0])(0.0)
    minor = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    return a[0, 0] > zero and minor > zero and wp.determinant(a) > zero


@wp.func
def snow_return(F: Any, h: Any, theta: Any, dt: Any):
    """Limit stretches to [smallest, largest]; the excess changes Jp (Stomakhin 2013, eqs. 9, 10).

    A particle breaks at a strain that differs from the material's `largest - 1` by the fraction
    h[1]. Nothing changes if the limits would increase the energy, because snow with a Poisson's
    ratio near 1/2 would otherwise gain energy by fracture.
    """
    s = F[0, 0]
    unit = type(s)(1.0)
    most = (theta[3] - unit) * (unit + h[1])
    eye = wp.identity(3, dtype=type(s))
    strain = gram(F) - eye
    lower = (theta[2] - unit) * (theta[2] + unit)
    upper = most * (type(s)(2.0) + most)
    if is_positive(strain - lower * eye) and is_positive(upper * eye - strain):
        return F, h
    if wp.ddot(strain, strain) < type(s)(CLOSE) and wp.determinant(F) > type(s)(0.0):
        return limit_stretches(F, strain, h, theta, most)
    exact = wp.vector(
        wp.float64(theta[0]), wp.float64(theta[1]), wp.float64(theta[2]), wp.float64(theta[3]),
        wp.float64(theta[4]),
    )  # fmt: skip
    before = wp.vector(wp.float64(h[0]), wp.float64(h[1]))
    wide = to_double(F)
    beyond = gram(wide) - wp.identity(3, dtype=wp.float64)
    limited, after = limit_stretches(wide, beyond, before, exact, wp.float64(most))
    return from_double(limited, s), wp.vector(type(s)(after[0]), type(s)(after[1]))
