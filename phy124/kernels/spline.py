"""Weights of the quadratic B-spline, and transfers by their gradients.

MLS-MPM takes stress and strain from the affine fit around a particle (kernels/transfer.py). That is
no gradient of the velocities that move the positions, so F comes to differ from the gradient of the
motion: a beam of two cells and two particles per cell and axis is bent by a quarter more than its F
says. With `scatter_with_stress` and `gather_slopes` F follows grad v = sum v_i (grad w_i)^T, and
the force on a node is -sum V tau grad w_i, its counterpart in the balance of energy (Sulsky et al.
1994; Stomakhin et al. 2013, eq. 6).
"""

from typing import Any

import warp as wp

from phy124.kernels.reduction import add, load


@wp.func
def spline(f: Any):
    """Quadratic B-spline weights of three nodes; f in [0.5, 1.5) is the distance to the first."""
    half = type(f)(0.5)
    a = type(f)(1.5) - f
    b = f - type(f)(1.0)
    c = f - half
    return wp.vector(half * a * a, type(f)(0.75) - b * b, half * c * c)


@wp.func
def slope(f: Any):
    """Derivatives of these weights by the particle's place, per cell."""
    return wp.vector(f - type(f)(1.5), type(f)(2.0) - type(f)(2.0) * f, f - type(f)(0.5))


@wp.func
def offsets(f: Any):
    """0, 1, 2 in the precision of f (casting a loop index would retype the index itself)."""
    return wp.vector(type(f)(0.0), type(f)(1.0), type(f)(2.0))


@wp.func
def scatter_with_stress(
    grid: wp.array(dtype=Any),
    size: wp.vec3i,
    first: wp.vec3i,
    f: Any,
    base: Any,
    column_x: Any,
    column_y: Any,
    column_z: Any,
    force_x: Any,
    force_y: Any,
    force_z: Any,
):
    """Add w (base + i X + j Y + k Z) + (dw/dx) S + (dw/dy) T + (dw/dz) U to 27 nodes."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    step = offsets(f[0])
    for i in range(3):
        for j in range(3):
            w = wx[i] * wy[j]
            low = w * (base + step[i] * column_x + step[j] * column_y)
            low += (sx[i] * wy[j]) * force_x + (wx[i] * sy[j]) * force_y
            rise = w * column_z
            turn = w * force_z
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            add(grid, n, wz[0] * low + sz[0] * turn)
            add(grid, n + 1, wz[1] * (low + rise) + sz[1] * turn)
            add(grid, n + 2, wz[2] * (low + rise + rise) + sz[2] * turn)


@wp.func
def gather_slopes(grid: wp.array(dtype=Any), size: wp.vec3i, first: wp.vec3i, f: Any):
    """Rows: sum (dw/dx) v, sum (dw/dy) v, sum (dw/dz) v over the 27 nodes, per cell."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    by_x = wp.vector(length=4, dtype=type(f[0]))
    by_y = wp.vector(length=4, dtype=type(f[0]))
    by_z = wp.vector(length=4, dtype=type(f[0]))
    for i in range(3):
        for j in range(3):
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            low = load(grid, n)
            middle = load(grid, n + 1)
            last = load(grid, n + 2)
            row = wz[0] * low + wz[1] * middle + wz[2] * last
            by_x += (sx[i] * wy[j]) * row
            by_y += (wx[i] * sy[j]) * row
            by_z += (wx[i] * wy[j]) * (sz[0] * low + sz[1] * middle + sz[2] * last)
    return wp.matrix_from_rows(by_x, by_y, by_z)
