"""Computes the motion of integration points from the nodes, and the points' forces on nodes.

The 27 nodes of a cell form nine rows of three nodes along z; `rows` contains the first node of each
row. `offset` is a point's position relative to the first node of its cell [cells]. Eight
consecutive points form a cell.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.elastic import safe_volume
from phy124.kernels.transfer import slope, spline

PER_CELL = 8


@wp.func
def at_point(values: wp.array(dtype=Any), rows: wp.array(dtype=int), cell: int, f: Any):
    """Return the sum of w_i a_i over the nodes of a cell."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    total = wp.vector(length=3, dtype=type(f[0]))
    for i in range(3):
        for j in range(3):
            n = rows[cell * 9 + i * 3 + j]
            row = wz[0] * values[n] + wz[1] * values[n + 1] + wz[2] * values[n + 2]
            total += (wx[i] * wy[j]) * row
    return total


@wp.func
def slopes_at(values: wp.array(dtype=Any), rows: wp.array(dtype=int), cell: int, f: Any):
    """Return the matrix with the columns sum (dw/dx) a, sum (dw/dy) a, sum (dw/dz) a, per cell."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    by_x = wp.vector(length=3, dtype=type(f[0]))
    by_y = wp.vector(length=3, dtype=type(f[0]))
    by_z = wp.vector(length=3, dtype=type(f[0]))
    for i in range(3):
        for j in range(3):
            n = rows[cell * 9 + i * 3 + j]
            low = values[n]
            middle = values[n + 1]
            high = values[n + 2]
            row = wz[0] * low + wz[1] * middle + wz[2] * high
            by_x += (sx[i] * wy[j]) * row
            by_y += (wx[i] * sy[j]) * row
            by_z += (wx[i] * wy[j]) * (sz[0] * low + sz[1] * middle + sz[2] * high)
    return wp.matrix_from_cols(by_x, by_y, by_z)


@wp.func
def spread(
    sums: wp.array(dtype=Any), low: int, rows: wp.array(dtype=int), cell: int, f: Any, a: Any
):
    """Add w_i a to the nodes of a cell; the first element of `sums` is node `low`."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    for i in range(3):
        for j in range(3):
            n = rows[cell * 9 + i * 3 + j] - low
            part = (wx[i] * wy[j]) * a
            for k in range(3):
                wp.atomic_add(sums, n + k, wz[k] * part)


@wp.func
def spread_slopes(
    sums: wp.array(dtype=Any), low: int, rows: wp.array(dtype=int), cell: int, f: Any, P: Any
):
    """Add P (dw_i/dx, dw_i/dy, dw_i/dz) to the nodes of a cell; `sums` begins with node `low`."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    sx = slope(f[0])
    sy = slope(f[1])
    sz = slope(f[2])
    by_x = wp.vector(P[0, 0], P[1, 0], P[2, 0])
    by_y = wp.vector(P[0, 1], P[1, 1], P[2, 1])
    by_z = wp.vector(P[0, 2], P[1, 2], P[2, 2])
    for i in range(3):
        for j in range(3):
            n = rows[cell * 9 + i * 3 + j] - low
            along = (sx[i] * wy[j]) * by_x + (wx[i] * sy[j]) * by_y
            across = (wx[i] * wy[j]) * by_z
            for k in range(3):
                wp.atomic_add(sums, n + k, wz[k] * along + sz[k] * across)


@wp.func
def inverse_rows(F: Any):
    """Return the cofactors of F: det F times the transpose of F's inverse."""
    return wp.matrix_from_rows(wp.cross(F[1], F[2]), wp.cross(F[2], F[0]), wp.cross(F[0], F[1]))


@build_once
def make_follow(real: Any):
    """Kernel over points: computes x, v, F and C = dF/dt F^-1 from the nodes."""

    @kernel(f"phy124_lattice_follow_{real.__name__}", real, seconds=0.4)
    def follow(start, dx, rows, offset, rest, u, v, x_out, v_out, C_out, F_out):
        p = start + wp.tid()
        cell = p / wp.static(PER_CELL)
        f = offset[p]
        x_out[p] = rest[p] + at_point(u, rows, cell, f)
        v_out[p] = at_point(v, rows, cell, f)
        F = wp.identity(3, dtype=real) + slopes_at(u, rows, cell, f) / dx
        rate = slopes_at(v, rows, cell, f) / dx
        F_out[p] = F
        C_out[p] = rate * wp.transpose(inverse_rows(F)) / safe_volume(wp.determinant(F))

    return follow


@build_once
def make_locate(real: Any):
    """Kernel over chosen points: computes x and v from the nodes, before forces act on points."""

    @kernel(f"phy124_lattice_locate_{real.__name__}", real, seconds=0.3)
    def locate(chosen, rows, offset, rest, u, v, x_out, v_out, v_kept_out):
        p = chosen[wp.tid()]
        cell = p / wp.static(PER_CELL)
        f = offset[p]
        x_out[p] = rest[p] + at_point(u, rows, cell, f)
        now = at_point(v, rows, cell, f)
        v_out[p] = now
        v_kept_out[p] = now

    return locate


@build_once
def make_push(real: Any):
    """Kernel over chosen points: adds forces on points, m (v - v_kept) / kick, to the nodes'
    forces.
    """

    @kernel(f"phy124_lattice_push_{real.__name__}", real, seconds=0.3)
    def push(chosen, low, mass, clock, rows, offset, v, v_kept, force_out):
        p = chosen[wp.tid()]
        change = v[p] - v_kept[p]
        if wp.dot(change, change) > real(0.0) and clock[0] > real(0.0):
            cell = p / wp.static(PER_CELL)
            spread(force_out, low, rows, cell, offset[p], (mass[p] / clock[0]) * change)

    return push


@build_once
def make_press(real: Any):
    """Kernel over points: adds the forces of a non-uniform acceleration to the nodes' forces.

    `turns` are 4 / dx^2 times the moments of the acceleration around the points. Only their
    antisymmetric part T acts; the symmetric part would excite vibrations. The force on node i is m
    w_i (a + T F^-T (X_i - X)) with the positions X at rest. The angular momentum is exact if the
    body is deformed uniformly near the point.
    """
    t = types(real)

    @kernel(f"phy124_lattice_press_{real.__name__}", real, seconds=0.3)
    def press(start, low, mass, dx, rows, offset, F, pushes: t.vec3s, turns: t.mat33s, force_out):
        p = start + wp.tid()
        f = offset[p]
        cell = p / wp.static(PER_CELL)
        turn = real(0.5) * (turns[p] - wp.transpose(turns[p]))
        T = (dx * mass[p] / safe_volume(wp.determinant(F[p]))) * (turn * inverse_rows(F[p]))
        first = mass[p] * pushes[p] - T * f
        wx = spline(f[0])
        wy = spline(f[1])
        wz = spline(f[2])
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    n = rows[cell * 9 + i * 3 + j] - low + k
                    at = wp.vec3i(i, j, k)
                    arm = wp.vector(real(at[0]), real(at[1]), real(at[2]))
                    wp.atomic_add(force_out, n, wx[i] * wy[j] * wz[k] * (first + T * arm))

    return press
