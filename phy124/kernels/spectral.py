"""Functions of a symmetric 3x3 matrix, computed from its eigenvalues without eigenvectors.

The eigenvalues are the roots of a cubic (Smith 1961). The quadratic that interpolates a function at
the eigenvalues (Newton's divided differences) gives the function of the matrix. If eigenvalues
coincide, the result remains exact up to rounding, because the error of each divided difference is
multiplied by the gap between the eigenvalues. Power series use the Cayley-Hamilton theorem: every
power of A is a quadratic c0 I + c1 A + c2 A^2.
"""

from typing import Any

import warp as wp

SQRT_3 = wp.constant(wp.float64(1.7320508075688772))
FIRST, SECOND = wp.constant(wp.float64(1 / 6)), wp.constant(wp.float64(0.016346))
"""Coefficients of a quadratic approximation of `farthest_root` (error at most 4e-3)."""


@wp.func
def to_double(m: Any):
    """Convert a 3x3 matrix to float64."""
    return wp.mat33d(
        wp.float64(m[0, 0]), wp.float64(m[0, 1]), wp.float64(m[0, 2]),
        wp.float64(m[1, 0]), wp.float64(m[1, 1]), wp.float64(m[1, 2]),
        wp.float64(m[2, 0]), wp.float64(m[2, 1]), wp.float64(m[2, 2]),
    )  # fmt: skip


@wp.func
def from_double(m: wp.mat33d, like: Any):
    """Convert a float64 matrix to the precision of the scalar `like`."""
    return wp.matrix_from_rows(
        wp.vector(type(like)(m[0, 0]), type(like)(m[0, 1]), type(like)(m[0, 2])),
        wp.vector(type(like)(m[1, 0]), type(like)(m[1, 1]), type(like)(m[1, 2])),
        wp.vector(type(like)(m[2, 0]), type(like)(m[2, 1]), type(like)(m[2, 2])),
    )


@wp.func
def distinctness(a: Any, b: Any):
    """Return the product of the squared differences between a symmetric matrix's eigenvalues.

    The product is a sum of squares of minors of the entries of I, A and A^2 (Parlett 2002). No
    terms cancel, so the result is exact to rounding. `b` is A^2.
    """
    off = wp.vector(a[0, 1], a[0, 2], a[1, 2])
    off_b = wp.vector(b[0, 1], b[0, 2], b[1, 2])
    d = wp.vector(a[0, 0] - a[1, 1], a[0, 0] - a[2, 2], a[1, 1] - a[2, 2])
    d_b = wp.vector(b[0, 0] - b[1, 1], b[0, 0] - b[2, 2], b[1, 1] - b[2, 2])
    mixed = wp.cross(off, off_b)
    minors = wp.outer(d, off_b) - wp.outer(d_b, off)
    first = d[0] * d_b[1] - d[1] * d_b[0]
    two = type(first)(2.0)
    return first * first + two * wp.ddot(minors, minors) + type(two)(12.0) * wp.dot(mixed, mixed)


@wp.func
def farthest_root(t: Any):
    """Return the root z >= sqrt(3) of z^3 - 3 z = t, 0 <= t <= 2, by three Newton steps."""
    unit = type(t)(1.0)
    z = type(t)(SQRT_3) + t * (type(t)(FIRST) - type(t)(SECOND) * t)
    for _ in range(3):
        square = z * z
        z = (type(t)(2.0) * square * z + t) / (type(t)(3.0) * (square - unit))
    return z


@wp.func
def decompose(a: Any):
    """Decompose a symmetric matrix A = q I + p D; return q, p, D, D^2 and the eigenvalues x of D.

    The trace of D is zero and its norm is sqrt(6). The eigenvalues x, largest first, are exact to
    rounding: they are the roots of x^3 - 3 x = det D. If A is a multiple of I, D is zero, and x is
    arbitrary.
    """
    s = a[0, 0]
    q = wp.trace(a) / type(s)(3.0)
    d = deviator(a)
    p = wp.sqrt(wp.ddot(d, d) / type(s)(6.0))
    if p > type(s)(0.0):
        d = (type(s)(1.0) / p) * d
    squared = gram(d)
    det = wp.determinant(d)
    z = farthest_root(wp.min(wp.abs(det), type(s)(2.0)))
    half = type(s)(0.5)
    apart = half * wp.sqrt(distinctness(d, squared)) / (type(s)(3.0) * (z * z - type(s)(1.0)))
    x = wp.vector(z, apart - half * z, -apart - half * z)
    if det < type(s)(0.0):
        x = wp.vector(half * z + apart, half * z - apart, -z)
    return q, p, d, squared, x


@wp.func
def eigenvalues(a: Any):
    """Return the eigenvalues of a symmetric matrix, largest first."""
    q, p, _, _, x = decompose(a)
    return wp.vector(q, q, q) + p * x


@wp.func
def slope(rise: Any, run: Any):
    """Return rise / run, or 0 if the two interpolation points coincide."""
    if run > type(run)(0.0):
        return rise / run
    return type(run)(0.0)


@wp.func
def interpolant(x: Any, f: Any):
    """Return the quadratic c0 + c1 t + c2 t^2 with the values f at the points x (largest first)."""
    first = slope(f[0] - f[1], x[0] - x[1])
    second = slope(first - slope(f[1] - f[2], x[1] - x[2]), x[0] - x[2])
    return wp.vector(f[0] - x[0] * (first - second * x[1]), first - second * (x[0] + x[1]), second)


@wp.func
def signed_stretch(F: wp.mat33d) -> wp.mat33d:
    """Return V of F = V R with a rotation R; the smallest stretch has the sign of det F."""
    q, p, d, squared, x = decompose(F * wp.transpose(F))
    zero = wp.float64(0.0)
    smallest = wp.sqrt(wp.max(q + p * x[2], zero))
    if wp.determinant(F) < zero:
        smallest = -smallest
    roots = wp.vec3d(
        wp.sqrt(wp.max(q + p * x[0], zero)), wp.sqrt(wp.max(q + p * x[1], zero)), smallest
    )
    return quadratic(interpolant(x, roots), d, squared)


@wp.func
def floored_log(F: wp.mat33d, floor: wp.float64) -> wp.mat33d:
    """Return log V of F = V R, with stretches of at least `floor`; reflections are ignored."""
    q, p, d, squared, x = decompose(F * wp.transpose(F))
    floor_squared = floor * floor
    logs = wp.vec3d(
        wp.log(wp.max(q + p * x[0], floor_squared)),
        wp.log(wp.max(q + p * x[1], floor_squared)),
        wp.log(wp.max(q + p * x[2], floor_squared)),
    )
    return quadratic(interpolant(x, wp.float64(0.5) * logs), d, squared)


@wp.func
def symmetric(xx: Any, xy: Any, xz: Any, yy: Any, yz: Any, zz: Any):
    """Return a symmetric matrix from its six entries."""
    return wp.matrix_from_rows(wp.vector(xx, xy, xz), wp.vector(xy, yy, yz), wp.vector(xz, yz, zz))


@wp.func
def gram(a: Any):
    """Return A A^T, which is the square of a symmetric A."""
    x = a[0]
    y = a[1]
    z = a[2]
    return symmetric(
        wp.dot(x, x), wp.dot(x, y), wp.dot(x, z), wp.dot(y, y), wp.dot(y, z), wp.dot(z, z)
    )


@wp.func
def deviator(a: Any):
    """Return A - tr A / 3 I."""
    mean = wp.trace(a) / type(a[0, 0])(3.0)
    return symmetric(a[0, 0] - mean, a[0, 1], a[0, 2], a[1, 1] - mean, a[1, 2], a[2, 2] - mean)


@wp.func
def invariants(a: Any, squared: Any):
    """Return the principal invariants of A; `squared` is A^2."""
    first = wp.trace(a)
    second = (first * first - wp.trace(squared)) * type(first)(0.5)
    return wp.vector(first, second, wp.determinant(a))


@wp.func
def next_power(c: Any, i: Any):
    """Return the coefficients of A (c0 I + c1 A + c2 A^2); i are the invariants of A."""
    return wp.vector(c[2] * i[2], c[0] - c[2] * i[1], c[1] + c[2] * i[0])


@wp.func
def quadratic(c: Any, a: Any, squared: Any):
    """Return c0 I + c1 A + c2 A^2."""
    return symmetric(
        c[0] + c[1] * a[0, 0] + c[2] * squared[0, 0],
        c[1] * a[0, 1] + c[2] * squared[0, 1],
        c[1] * a[0, 2] + c[2] * squared[0, 2],
        c[0] + c[1] * a[1, 1] + c[2] * squared[1, 1],
        c[1] * a[1, 2] + c[2] * squared[1, 2],
        c[0] + c[1] * a[2, 2] + c[2] * squared[2, 2],
    )


@wp.func
def linear_range(s: wp.float32):
    """Return the |A|^2 below which exp A is I + A, and atanh A is A, up to rounding.

    Higher powers of so small a matrix A would be denormal numbers, which are slow.
    """
    return wp.float32(1.0e-10)


@wp.func
def linear_range(s: wp.float64):  # noqa: F811
    """Return the |A|^2 below which exp A is I + A, and atanh A is A, up to rounding."""
    return wp.float64(1.0e-18)


@wp.func
def small_enough(s: wp.float32):
    """Return the |A|^2 up to which exp A, summed to A^5 / 120, is exact to rounding."""
    return wp.float32(0.015625)


@wp.func
def small_enough(s: wp.float64):  # noqa: F811
    """Return the |A|^2 up to which exp A, summed to A^5 / 120, is exact to rounding."""
    return wp.float64(2.5e-5)


@wp.func
def exponential(a: Any):
    """Return exp A: the series up to A^5 / 120 of A / 2^n, squared n times."""
    s = a[0, 0]
    small = a
    size = wp.ddot(a, a)
    if size < linear_range(s):
        return wp.identity(3, dtype=type(s)) + a
    doublings = int(0)
    while size > small_enough(s) and doublings < 24:
        small = type(s)(0.5) * small
        size *= type(s)(0.25)
        doublings += 1
    squared = gram(small)
    i = invariants(small, squared)
    power = wp.vector(type(s)(0.0), type(s)(0.0), type(s)(0.5))
    total = wp.vector(type(s)(1.0), type(s)(1.0), type(s)(0.5))
    n = type(s)(2.0)
    for _ in range(3):
        n += type(s)(1.0)
        power = (type(s)(1.0) / n) * next_power(power, i)
        total += power
    result = quadratic(total, small, squared)
    while doublings > 0:
        result = gram(result)
        doublings -= 1
    return result
