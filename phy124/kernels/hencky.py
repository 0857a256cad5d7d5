"""Hencky strain (the logarithm of the stretch) and the elastic law in this strain, without an SVD.

With b = F F^T and Z = (b - I)(b + I)^-1, log V = 1/2 log b = atanh Z is an odd power series in Z.
Let X = b - I, with invariants i; then Z = (i3 + (4 + 2 i1) X - 2 X^2) / (8 + 4 i1 + 2 i2 + i3). In
float32 the series is used for stretches between 0.72 and 1.39 (error 3e-8), in float64 between 0.91
and 1.09 (error 2e-15). For other stretches, the closed form of `spectral` is used.
"""

from typing import Any

import warp as wp

from phy124.kernels.elastic import newtonian
from phy124.kernels.spectral import (
    floored_log,
    from_double,
    gram,
    invariants,
    linear_range,
    next_power,
    quadratic,
    symmetric,
    to_double,
)

SMALLEST_STRETCH = wp.constant(1.0e-4)
"""Lower bound of stretches; makes the strain of a flat element finite."""


@wp.func
def series_range(s: wp.float32):
    """Return the largest |Z|^2 for which the series is used.

    The first omitted term is Z^13 / 13.
    """
    return wp.float32(0.1)


@wp.func
def series_range(s: wp.float64):  # noqa: F811
    """Return the largest |Z|^2 for which the series is used."""
    return wp.float64(0.008)


@wp.func
def left_strain(F: Any):
    """Return X = F F^T - I."""
    s = F[0, 0]
    b = gram(F)
    unit = type(s)(1.0)
    return symmetric(b[0, 0] - unit, b[0, 1], b[0, 2], b[1, 1] - unit, b[1, 2], b[2, 2] - unit)


@wp.func
def inverse_tanh(z: Any):
    """Return the coefficients of a quadratic in Z that equals the series of atanh Z up to Z^11.

    `z` contains the invariants of Z. The sum is first reduced to a quadratic in W = Z^2: atanh Z =
    Z (1 + W/3 + W^2/5 + ...). This reduction takes half as many steps as the reduction of a series
    in Z.
    """
    unit = type(z[0])(1.0)
    two = type(z[0])(2.0)
    w = wp.vector(z[0] * z[0] - two * z[1], z[1] * z[1] - two * z[0] * z[2], z[2] * z[2])
    power = wp.vector(w[2], -w[1], w[0])
    total = wp.vector(unit, unit / type(unit)(3.0), unit / type(unit)(5.0))
    total += (unit / type(unit)(7.0)) * power
    power = next_power(power, w)
    total += (unit / type(unit)(9.0)) * power
    total += (unit / type(unit)(11.0)) * next_power(power, w)
    cube = wp.vector(z[2], -z[1], z[0])
    fifth = next_power(next_power(cube, z), z)
    return wp.vector(
        total[1] * cube[0] + total[2] * fifth[0],
        total[0] + total[1] * cube[1] + total[2] * fifth[1],
        total[1] * cube[2] + total[2] * fifth[2],
    )


@wp.func
def log_strain(F: Any):
    """Return the Hencky strain log V of F = V R for any F; reflections are ignored."""
    s = F[0, 0]
    two = type(s)(2.0)
    four = type(s)(4.0)
    x = left_strain(F)
    squared = gram(x)
    i = invariants(x, squared)
    fraction = type(s)(1.0) / (type(s)(8.0) + four * i[0] + two * i[1] + i[2])
    z = quadratic(fraction * wp.vector(i[2], four + two * i[0], -two), x, squared)
    z_squared = gram(z)
    size = wp.trace(z_squared)
    if size < linear_range(s):
        return z
    if not size < series_range(s):
        return from_double(floored_log(to_double(F), wp.float64(SMALLEST_STRETCH)), s)
    return quadratic(inverse_tanh(invariants(z, z_squared)), z, z_squared)


@wp.func
def hencky_energy(F: Any, h: Any, theta: Any):
    """Return mu |e|^2 + lam/2 (tr e)^2, e = log V; theta = (mu, lam, ...)."""
    e = log_strain(F)
    t = wp.trace(e)
    return theta[0] * wp.ddot(e, e) + type(t)(0.5) * theta[1] * t * t


@wp.func
def hencky(F: Any, C: Any, h: Any, theta: Any):
    """Return 2 mu e + lam tr(e) I, e = log V (Hencky 1928; Klar et al. 2016, eq. 26)."""
    e = log_strain(F)
    t = wp.trace(e)
    return type(t)(2.0) * theta[0] * e + theta[1] * t * wp.identity(3, dtype=type(t))


@wp.func
def cosh_of_difference(F: Any):
    """Return an upper bound of cosh x for the largest difference x of principal strains; 1 at rest.

    Scale F F^T to determinant 1, with eigenvalues e^y. The mean of the traces of the scaled matrix
    and its inverse is sum cosh y. Since sum y = 0, sum cosh y is at least 1 + 2 cosh x.
    """
    s = F[0, 0]
    a = wp.cross(F[1], F[2])
    b = wp.cross(F[2], F[0])
    c = wp.cross(F[0], F[1])
    J = wp.dot(F[0], a)
    flat = type(s)(SMALLEST_STRETCH) * type(s)(SMALLEST_STRETCH) * type(s)(SMALLEST_STRETCH)
    scale = wp.cbrt(wp.max(J * J, flat * flat))
    total = wp.ddot(F, F) / scale + (wp.dot(a, a) + wp.dot(b, b) + wp.dot(c, c)) / (scale * scale)
    return type(s)(0.25) * total - type(s)(0.5)


@wp.func
def hencky_modulus(F: Any, h: Any, theta: Any):
    """Return 2 mu min(k^(2/3), 1 + ln 2k) + 3 max(lam, 0), k = `cosh_of_difference`.

    Shear between two axes has the modulus 2 mu x coth x, where x is the difference of the axes'
    strains. This modulus is below 2 mu (1 + x), and below 2 mu (cosh x)^(2/3) by Lazarevic's
    inequality (sinh x / x)^3 > cosh x.
    """
    zero = type(theta[0])(0.0)
    two = type(theta[0])(2.0)
    k = cosh_of_difference(F)
    root = wp.cbrt(k)
    shear = wp.min(root * root, type(k)(1.0) + wp.log(two * k))
    return two * theta[0] * shear + type(zero)(3.0) * wp.max(theta[1], zero)


@wp.func
def hencky_damped(F: Any, C: Any, h: Any, theta: Any):
    """Return the Hencky stress plus viscosity; theta = (mu, lam, eta)."""
    return hencky(F, C, h, theta) + newtonian(F, C, theta[2])
