"""Elastic laws: Kirchhoff stress tau [Pa] as a function of the deformation gradient F.

The modulus of a law is an upper bound of the largest eigenvalue of d tau / d ln sigma
(docs/design/laws.md). `theta` contains the parameters of the law, `h` the history variables (unused
by elastic laws), and `C` the velocity gradient.
"""

from typing import Any

import warp as wp

from phy124.kernels.spectral import (
    deviator,
    from_double,
    gram,
    invariants,
    next_power,
    quadratic,
    signed_stretch,
    symmetric,
    to_double,
)

SMALLEST_J = wp.constant(1.0e-4)
"""Volume ratio below which log J is continued by its tangent, so that inverted elements resist."""


@wp.func
def safe_volume(J: Any):
    """Return max(J, r); below the volume ratio r, elastic laws replace log J by its tangent."""
    return wp.max(J, type(J)(SMALLEST_J))


@wp.func
def signed_volume(J: Any):
    """Return J, or a small value of the same sign if J is nearly zero."""
    return wp.where(J < type(J)(0.0), wp.min(J, -type(J)(SMALLEST_J)), safe_volume(J))


@wp.func
def polar_miss(s: wp.float32):
    """Return the largest |R|^2 - 3 for which R counts as a rotation (error 1e-6)."""
    return wp.float32(2.0e-6)


@wp.func
def polar_miss(s: wp.float64):  # noqa: F811
    """Return the largest |R|^2 - 3 for which R counts as a rotation."""
    return wp.float64(1.0e-12)


@wp.func
def polar_step(R: Any):
    """Return the mean of R and its inverse transpose: one step of Newton's iteration."""
    half = type(R[0, 0])(0.5)
    a = wp.cross(R[1], R[2])
    b = wp.cross(R[2], R[0])
    c = wp.cross(R[0], R[1])
    k = half / wp.dot(R[0], a)
    return wp.matrix_from_rows(half * R[0] + k * a, half * R[1] + k * b, half * R[2] + k * c)


@wp.func
def polar(F: Any):
    """Return the polar rotation of F by Newton's iteration (Higham 1986); det F must be positive.

    After each step the singular values of R are at least 1, so |R|^2 - 3 measures the deviation
    from a rotation. In float32, three steps suffice for stretches between 0.75 and 1.35, and five
    steps for stretches between 0.3 and 4.
    """
    s = F[0, 0]
    R = polar_step(polar_step(polar_step(F)))
    if wp.ddot(R, R) >= type(s)(3.0) + polar_miss(s):
        R = polar_step(polar_step(R))
    return R


@wp.func
def series_range(s: wp.float32):
    """Return the |A|^2 up to which `root`, summed to A^5, is exact to rounding."""
    return wp.float32(0.0144)


@wp.func
def series_range(s: wp.float64):  # noqa: F811
    """Return the |A|^2 up to which `root`, summed to A^5, is exact to rounding."""
    return wp.float64(1.0e-5)


@wp.func
def root(a: Any):
    """Return sqrt(I + A) of a small symmetric A: the binomial series up to A^5."""
    s = a[0, 0]
    squared = gram(a)
    i = invariants(a, squared)
    third = wp.vector(i[2], -i[1], i[0])
    fourth = next_power(third, i)
    total = type(s)(0.0625) * third - type(s)(0.0390625) * fourth
    total += type(s)(0.02734375) * next_power(fourth, i)
    total += wp.vector(type(s)(1.0), type(s)(0.5), type(s)(-0.125))
    return quadratic(total, a, squared)


@wp.func
def stretch(F: Any):
    """Return V of F = V R for any F."""
    s = F[0, 0]
    strain = gram(F) - wp.identity(3, dtype=type(s))
    if wp.ddot(strain, strain) < series_range(s) and wp.determinant(F) > type(s)(0.0):
        return root(strain)
    R = polar(F)
    if wp.determinant(F) > type(s)(0.0) and wp.ddot(R, R) < type(s)(3.0) + polar_miss(s):
        return F * wp.transpose(R)
    return from_double(signed_stretch(to_double(F)), s)


@wp.func
def log_volume_far(J: Any):
    """Return log J, continued linearly below SMALLEST_J so that inverted elements resist."""
    floor = type(J)(SMALLEST_J)
    if J > floor:
        return wp.log(J)
    return wp.log(floor) + (J - floor) / floor


@wp.func
def log_volume(J: wp.float64):
    """Return the logarithm of the volume ratio J."""
    return log_volume_far(J)


@wp.func
def log_volume(J: wp.float32):  # noqa: F811
    """Return the logarithm of the volume ratio J.

    For |J - 1| < 0.2, log(1 + y) / y is replaced by its best polynomial approximation, which takes
    a third of the time of log. The polynomial's error is 3e-8 (1.4e-7 with rounding errors), and
    the result is exactly 0 at J = 1.
    """
    y = J - 1.0
    if wp.abs(y) >= 0.2:
        return log_volume_far(J)
    y2 = y * y
    low = (1.0 - 0.5000009 * y) + y2 * (0.33333524 - 0.24981497 * y)
    high = (0.19976348 - 0.17579095 * y) + y2 * 0.15217274
    return y * (low + (y2 * y2) * high)


@wp.func
def largest_stretch_squared(F: Any):
    """Return an upper bound of the largest eigenvalue of F F^T, without an SVD."""
    b = gram(F)
    s = F[0, 0]
    dev = deviator(b)
    return wp.trace(b) / type(s)(3.0) + wp.sqrt(type(s)(2.0) / type(s)(3.0) * wp.ddot(dev, dev))


@wp.func
def neo_hookean_energy(F: Any, h: Any, theta: Any):
    """Return mu/2 (|F|^2 - 3) - mu log J + lam/2 (log J)^2 (Bonet and Wood 2008, eq. 6.27)."""
    two = type(theta[0])(2.0)
    log_j = log_volume(wp.determinant(F))
    return (
        theta[0] / two * (wp.ddot(F, F) - type(theta[0])(3.0))
        - theta[0] * log_j
        + theta[1] / two * log_j * log_j
    )


@wp.func
def neo_hookean(F: Any, C: Any, h: Any, theta: Any):
    """Return mu (F F^T - I) + lam log J I (Bonet and Wood 2008, eq. 6.29); theta = (mu, lam)."""
    p = theta[1] * log_volume(wp.determinant(F)) - theta[0]
    b = gram(F)
    mu = theta[0]
    # Each matrix entry is computed separately, since the compiler does not remove products with the
    # zeros of the identity.
    return symmetric(
        mu * b[0, 0] + p, mu * b[0, 1], mu * b[0, 2],
        mu * b[1, 1] + p, mu * b[1, 2], mu * b[2, 2] + p,
    )  # fmt: skip


@wp.func
def neo_hookean_modulus(F: Any, h: Any, theta: Any):
    """Return 2 mu s^2 + 3 max(lam, 0), where s is the largest stretch; lam < 0 for auxetics."""
    zero = type(theta[0])(0.0)
    return type(zero)(2.0) * theta[0] * largest_stretch_squared(F) + type(zero)(3.0) * wp.max(
        theta[1], zero
    )


@wp.func
def fixed_corotated_energy(F: Any, h: Any, theta: Any):
    """Return mu |F - R|^2 + lam/2 (J - 1)^2, with |F - R| = |V - I| (Stomakhin et al. 2012)."""
    j1 = wp.determinant(F) - type(theta[0])(1.0)
    d = stretch(F) - wp.identity(3, dtype=type(j1))
    return theta[0] * wp.ddot(d, d) + type(j1)(0.5) * theta[1] * j1 * j1


@wp.func
def fixed_corotated(F: Any, C: Any, h: Any, theta: Any):
    """Return 2 mu (F F^T - V) + lam J (J - 1) I (Stomakhin et al. 2012)."""
    J = wp.determinant(F)
    V = stretch(F)
    b = gram(F)
    shear = type(J)(2.0) * theta[0]
    p = theta[1] * J * (J - type(J)(1.0))
    return symmetric(
        shear * (b[0, 0] - V[0, 0]) + p, shear * (b[0, 1] - V[0, 1]), shear * (b[0, 2] - V[0, 2]),
        shear * (b[1, 1] - V[1, 1]) + p, shear * (b[1, 2] - V[1, 2]),
        shear * (b[2, 2] - V[2, 2]) + p,
    )  # fmt: skip


@wp.func
def fixed_corotated_modulus(F: Any, h: Any, theta: Any):
    """Return 2 mu (2 s^2 - s) + 3 max(lam (2 J^2 - J), 0), where s >= 1 is the largest stretch."""
    unit = type(theta[0])(1.0)
    two = type(theta[0])(2.0)
    s2 = wp.max(largest_stretch_squared(F), unit)
    J = wp.determinant(F)
    volumetric = wp.max(theta[1] * (two * J * J - J), type(J)(0.0))
    return two * theta[0] * (two * s2 - wp.sqrt(s2)) + type(J)(3.0) * volumetric


@wp.func
def newtonian(F: Any, C: Any, eta: Any):
    """Return J eta (C + C^T): Kirchhoff stress of sigma = 2 eta D, with D the rate of strain.

    J is limited to 0 to 1: viscosity must not add energy to an inverted element, and the limit of
    the substep assumes J <= 1.
    """
    strength = wp.clamp(wp.determinant(F), type(eta)(0.0), type(eta)(1.0)) * eta
    return strength * (C + wp.transpose(C))


@wp.func
def neo_hookean_damped(F: Any, C: Any, h: Any, theta: Any):
    """Return the neo-Hookean stress plus viscosity; theta = (mu, lam, eta)."""
    return neo_hookean(F, C, h, theta) + newtonian(F, C, theta[2])


@wp.func
def fixed_corotated_damped(F: Any, C: Any, h: Any, theta: Any):
    """Return the fixed corotated stress plus viscosity; theta = (mu, lam, eta)."""
    return fixed_corotated(F, C, h, theta) + newtonian(F, C, theta[2])
