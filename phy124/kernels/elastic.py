"""Elastic laws: Kirchhoff stress tau [Pa] of a deformation gradient F.

Every law has a stress, an energy per rest volume whose derivative it is, and a modulus: an upper
bound of the largest eigenvalue of d tau / d ln sigma, which limits the substep (docs/physics.md).
`theta` holds the law's parameters, `h` its history (unused here), `C` the velocity gradient.
"""

from typing import Any

import warp as wp

SMALLEST_J = wp.constant(1.0e-4)
"""Volume ratio below which log J is continued by its tangent, so inverted elements push back."""


@wp.func
def polar(F: Any):
    """Rotation of the polar decomposition by Newton's iteration (Higham 1986); needs det F > 0."""
    half = type(F[0, 0])(0.5)
    R = F
    for _ in range(4):
        a = wp.cross(R[1], R[2])
        b = wp.cross(R[2], R[0])
        c = wp.cross(R[0], R[1])
        R = half * (R + wp.matrix_from_rows(a, b, c) / wp.dot(R[0], a))
    return R


@wp.func
def log_volume(J: Any):
    """log J, continued linearly below SMALLEST_J: finite and repelling for every J."""
    floor = type(J)(SMALLEST_J)
    if J > floor:
        return wp.log(J)
    return wp.log(floor) + (J - floor) / floor


@wp.func
def largest_stretch_squared(F: Any):
    """Upper bound of the largest eigenvalue of F F^T, without an SVD."""
    b = F * wp.transpose(F)
    third = wp.trace(b) / type(F[0, 0])(3.0)
    dev = b - third * wp.identity(3, dtype=type(F[0, 0]))
    return third + wp.sqrt(type(F[0, 0])(2.0) / type(F[0, 0])(3.0) * wp.ddot(dev, dev))


@wp.func
def neo_hookean_energy(F: Any, h: Any, theta: Any):
    """mu/2 (|F|^2 - 3) - mu log J + lam/2 (log J)^2 (Bonet and Wood 2008, eq. 6.27)."""
    two = type(theta[0])(2.0)
    log_j = log_volume(wp.determinant(F))
    return (
        theta[0] / two * (wp.ddot(F, F) - type(theta[0])(3.0))
        - theta[0] * log_j
        + theta[1] / two * log_j * log_j
    )


@wp.func
def neo_hookean(F: Any, C: Any, h: Any, theta: Any):
    """mu (F F^T - I) + lam log J I (Bonet and Wood 2008, eq. 6.29); theta = (mu, lam)."""
    p = theta[1] * log_volume(wp.determinant(F)) - theta[0]
    return theta[0] * (F * wp.transpose(F)) + p * wp.identity(3, dtype=type(p))


@wp.func
def neo_hookean_modulus(F: Any, h: Any, theta: Any):
    """2 mu s^2 + 3 lam, s the largest stretch."""
    return (
        type(theta[0])(2.0) * theta[0] * largest_stretch_squared(F) + type(theta[0])(3.0) * theta[1]
    )


@wp.func
def fixed_corotated_energy(F: Any, h: Any, theta: Any):
    """mu |F - R|^2 + lam/2 (J - 1)^2 (Stomakhin et al. 2012)."""
    one = type(theta[0])(1.0)
    j1 = wp.determinant(F) - one
    d = F - polar(F)
    return theta[0] * wp.ddot(d, d) + theta[1] / type(theta[0])(2.0) * j1 * j1


@wp.func
def fixed_corotated(F: Any, C: Any, h: Any, theta: Any):
    """2 mu (F - R) F^T + lam J (J - 1) I (Stomakhin et al. 2012); theta = (mu, lam)."""
    one = type(theta[0])(1.0)
    J = wp.determinant(F)
    d = (F - polar(F)) * wp.transpose(F)
    return theta[0] * (d + wp.transpose(d)) + theta[1] * J * (J - one) * wp.identity(
        3, dtype=type(J)
    )


@wp.func
def fixed_corotated_modulus(F: Any, h: Any, theta: Any):
    """2 mu (2 s^2 - s) + 3 lam max(2 J^2 - J, 0), s the largest stretch (at least 1)."""
    one = type(theta[0])(1.0)
    two = type(theta[0])(2.0)
    s2 = wp.max(largest_stretch_squared(F), one)
    J = wp.determinant(F)
    volumetric = wp.max(two * J * J - J, type(J)(0.0))
    return two * theta[0] * (two * s2 - wp.sqrt(s2)) + type(J)(3.0) * theta[1] * volumetric
