"""Computes functions of a symmetric 3x3 matrix from eigenvalues, in float64, without eigenvectors.

The eigenvalues have a closed form (Smith 1961). A function of the matrix is then the quadratic
polynomial that interpolates the function at the eigenvalues (Newton's divided differences). If
eigenvalues coincide, the result remains exact up to rounding, because the error of each divided
difference is multiplied by the gap between the eigenvalues. The laws use these functions only for
the few particles for which faster formulas are not accurate.

The module also computes squares of symmetric 3x3 matrices, and power series by the Cayley-Hamilton
theorem. Every power of A is a quadratic c0 I + c1 A + c2 A^2, whose coefficients follow from the
invariants of A. Each further term of a series therefore costs a few scalar operations but no matrix
product.
"""

from typing import Any

import warp as wp

THIRD_TURN = wp.constant(wp.float64(2.0943951023931953))


@wp.func
def to_double(m: Any):
    """Return a 3x3 matrix in float64."""
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
def eigenvalues(b: wp.mat33d) -> wp.vec3d:
    """Return the eigenvalues of a symmetric matrix, largest first."""
    unit = wp.float64(1.0)
    q = wp.trace(b) / wp.float64(3.0)
    d = b - q * wp.identity(3, dtype=wp.float64)
    p = wp.sqrt(wp.ddot(d, d) / wp.float64(6.0))
    if p <= wp.float64(0.0):
        return wp.vec3d(q, q, q)
    angle = wp.acos(wp.clamp(wp.determinant(d / p) / wp.float64(2.0), -unit, unit)) / wp.float64(
        3.0
    )
    high = q + wp.float64(2.0) * p * wp.cos(angle)
    low = q + wp.float64(2.0) * p * wp.cos(angle + THIRD_TURN)
    return wp.vec3d(high, wp.float64(3.0) * q - high - low, low)


@wp.func
def slope(rise: wp.float64, run: wp.float64) -> wp.float64:
    """Return rise / run, or 0 if the two interpolation nodes coincide."""
    if run > wp.float64(0.0):
        return rise / run
    return wp.float64(0.0)


@wp.func
def with_values(b: wp.mat33d, at: wp.vec3d, f: wp.vec3d) -> wp.mat33d:
    """Return f(b), computed from the values f_i = f(at_i) at the eigenvalues at_i of b (largest
    first).
    """
    first = slope(f[0] - f[1], at[0] - at[1])
    second = slope(first - slope(f[1] - f[2], at[1] - at[2]), at[0] - at[2])
    unit = wp.identity(3, dtype=wp.float64)
    return f[0] * unit + (b - at[0] * unit) * (first * unit + second * (b - at[1] * unit))


@wp.func
def signed_stretch(F: wp.mat33d) -> wp.mat33d:
    """Return V of F = V R, where R is a rotation even if F is singular or inverted.

    The smallest stretch has the sign of det F.
    """
    b = F * wp.transpose(F)
    at = eigenvalues(b)
    zero = wp.float64(0.0)
    smallest = wp.sqrt(wp.max(at[2], zero))
    if wp.determinant(F) < zero:
        smallest = -smallest
    return with_values(
        b, at, wp.vec3d(wp.sqrt(wp.max(at[0], zero)), wp.sqrt(wp.max(at[1], zero)), smallest)
    )


@wp.func
def floored_log(F: wp.mat33d, floor: wp.float64) -> wp.mat33d:
    """Return log V for F = V R.

    Stretches below `floor` are set to `floor`; reflections are ignored.
    """
    b = F * wp.transpose(F)
    at = eigenvalues(b)
    half = wp.float64(0.5)
    floor_squared = floor * floor
    return with_values(
        b,
        at,
        half
        * wp.vec3d(
            wp.log(wp.max(at[0], floor_squared)),
            wp.log(wp.max(at[1], floor_squared)),
            wp.log(wp.max(at[2], floor_squared)),
        ),
    )


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
    """Return the deviatoric part of A, A - tr A / 3 I."""
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
    """Return the coefficients of A (c0 I + c1 A + c2 A^2) as a quadratic in A with the invariants
    i.
    """
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
    """Return the |A|^2 below which exp A is I + A, and atanh A is A, up to rounding in float32.

    Higher powers of so small a matrix A would be denormal numbers, which are slow.
    """
    return wp.float32(1.0e-10)


@wp.func
def linear_range(s: wp.float64):  # noqa: F811
    """Return the |A|^2 below which exp A is I + A, and atanh A is A, up to rounding in float64."""
    return wp.float64(1.0e-18)


@wp.func
def small_enough(s: wp.float32):
    """Return the |A|^2 up to which exp A, summed to A^5 / 120, is exact to rounding in float32."""
    return wp.float32(0.015625)


@wp.func
def small_enough(s: wp.float64):  # noqa: F811
    """Return the |A|^2 up to which exp A, summed to A^5 / 120, is exact to rounding in float64."""
    return wp.float64(2.5e-5)


@wp.func
def exponential(a: Any):
    """Return exp A: halve A until it is small, sum the series up to A^5 / 120, and square the sum
    repeatedly.
    """
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
