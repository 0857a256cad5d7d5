"""Transfers between particles and the faces of a staggered grid: APIC with quadratic B-splines.

A particle reaches 4 x 4 x 4 cells. The weights of faces and centres differ by a shift of half a
cell, so some of the four weights along an axis are zero. See Jiang et al. 2015, "The affine
particle-in-cell method". On CPUs, native/liquid.h is used in float32.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.liquid.faces import cell_at, inner, local, number, sums
from phy124.kernels.liquid.surface import LONE
from phy124.kernels.native import code
from phy124.kernels.transfer import spline

vec8 = wp.types.vector(8, wp.float32)


@wp.func
def at_centres(t: Any):
    """Return quadratic weights for the centres of four cells in a row around a particle.

    `t` is the offset of the particle in the second cell.
    """
    w = spline(t + type(t)(0.5))
    return wp.vector(w[0], w[1], w[2], type(t)(0.0))


@wp.func
def at_faces(t: Any):
    """Return quadratic weights for the low faces of four cells; `t` is as in `at_centres`."""
    zero = type(t)(0.0)
    if t < type(t)(0.5):
        w = spline(t + type(t)(1.0))
        return wp.vector(w[0], w[1], w[2], zero)
    w = spline(t)
    return wp.vector(zero, w[0], w[1], w[2])


@wp.func
def at_hats(t: Any):
    """Return linear weights for the centres of four cells; `t` is as in `at_centres`."""
    zero = type(t)(0.0)
    half = type(t)(0.5)
    if t < half:
        return wp.vector(half - t, half + t, zero, zero)
    return wp.vector(zero, type(t)(1.5) - t, t - half, zero)


@wp.func
def weights(t: Any, axis: int):
    """Return weights of four cells: a row per cell, a column per face or centre."""
    c = at_centres(t)
    f = at_faces(t)
    zero = type(t)(0.0)
    rows = wp.matrix_from_rows(
        wp.vector(c[0], c[0], c[0], c[0]),
        wp.vector(c[1], c[1], c[1], c[1]),
        wp.vector(c[2], c[2], c[2], c[2]),
        wp.vector(zero, zero, zero, zero),
    )
    for a in range(4):
        rows[a, axis] = f[a]
    return rows


@wp.func
def offset(s: Any, low: wp.vec3i, axis: int):
    """Return the distances along an axis from a particle to a cell's low faces and centre."""
    half = type(s[0])(0.5)
    d = type(s[0])(low[axis]) - s[axis] + half
    result = wp.vector(d, d, d, d)
    result[axis] = d - half
    return result


@wp.func
def scatter(
    cells: wp.array(dtype=Any),
    size: wp.vec3i,
    first: int,
    t: Any,
    mass: Any,
    base: Any,
    column_x: Any,
    column_y: Any,
    column_z: Any,
):
    """Add w (base + i X + j Y + k Z) and the faces' masses to the 64 cells around a particle.

    t is the particle's offset in the second of four cells along each axis [cells]. The fourth
    component of `base` is the volume, which is also added with linear weights.
    """
    wx = weights(t[0], 0)
    wy = weights(t[1], 1)
    wz = weights(t[2], 2)
    hx = at_hats(t[0])
    hy = at_hats(t[1])
    hz = at_hats(t[2])
    step = counted(t[0])
    for a in range(4):
        for b in range(4):
            w = wp.cw_mul(wx[a], wy[b])
            value = base + step[a] * column_x + step[b] * column_y
            hat = base[3] * hx[a] * hy[b]
            n = first + (a * size[1] + b) * size[2]
            for c in range(4):
                ww = wp.cw_mul(w, wz[c])
                q = wp.cw_mul(ww, value + step[c] * column_z)
                faces = mass * ww
                row = wp.vector(q[0], q[1], q[2], q[3], faces[0], faces[1], faces[2], hat * hz[c])
                wp.atomic_add(cells, n + c, row)


@wp.func
def scatter_volume(fills: wp.array(dtype=Any), size: wp.vec3i, first: int, t: Any, volume: Any):
    """Add a volume with quadratic and with linear weights to the centres of 27 cells."""
    wx = at_centres(t[0])
    wy = at_centres(t[1])
    wz = at_centres(t[2])
    hx = at_hats(t[0])
    hy = at_hats(t[1])
    hz = at_hats(t[2])
    for a in range(3):
        for b in range(3):
            w = volume * wx[a] * wy[b]
            h = volume * hx[a] * hy[b]
            n = first + (a * size[1] + b) * size[2]
            for c in range(3):
                wp.atomic_add(fills, n + c, wp.vector(w * wz[c], h * hz[c]))


@wp.func
def gather(velocity: wp.array(dtype=Any), size: wp.vec3i, first: int, t: Any):
    """Return rows sum w v, sum w i v, sum w j v, sum w k v over the 64 cells around a particle."""
    wx = weights(t[0], 0)
    wy = weights(t[1], 1)
    wz = weights(t[2], 2)
    step = counted(t[0])
    mean = wp.vector(length=4, dtype=type(t[0]))
    by_x = wp.vector(length=4, dtype=type(t[0]))
    by_y = wp.vector(length=4, dtype=type(t[0]))
    by_z = wp.vector(length=4, dtype=type(t[0]))
    for i in range(4):
        for j in range(4):
            n = first + (i * size[1] + j) * size[2]
            row = wp.vector(length=4, dtype=type(t[0]))
            along = wp.vector(length=4, dtype=type(t[0]))
            for k in range(4):
                q = wp.cw_mul(wz[k], velocity[n + k])
                row += q
                along += step[k] * q
            w = wp.cw_mul(wx[i], wy[j])
            row = wp.cw_mul(w, row)
            mean += row
            by_x += step[i] * row
            by_y += step[j] * row
            by_z += wp.cw_mul(w, along)
    return wp.matrix_from_rows(mean, by_x, by_y, by_z)


@wp.func
def flow(velocity: wp.array(dtype=Any), size: wp.vec3i, first: int, t: Any):
    """Return the velocity at a point, by linear interpolation of each component."""
    unit = type(t[0])(1.0)
    result = t
    for axis in range(3):
        wx = at_hats(t[0])
        wy = at_hats(t[1])
        wz = at_hats(t[2])
        on_faces = wp.vector(type(unit)(0.0), unit - t[axis], t[axis], type(unit)(0.0))
        if axis == 0:
            wx = on_faces
        if axis == 1:
            wy = on_faces
        if axis == 2:
            wz = on_faces
        total = type(unit)(0.0)
        for i in range(3):
            for j in range(3):
                n = first + (i * size[1] + j) * size[2]
                w = wx[i] * wy[j]
                total += w * (
                    wz[0] * velocity[n][axis]
                    + wz[1] * velocity[n + 1][axis]
                    + wz[2] * velocity[n + 2][axis]
                )
        result[axis] = total
    return result


@wp.func_native(code("liquid", "liquid:scatter"))
def scatter_rows(
    cells: wp.array(dtype=vec8),
    size: wp.vec3i,
    first: int,
    t: wp.vec3,
    mass: wp.float32,
    base: wp.vec4,
    column_x: wp.vec4,
    column_y: wp.vec4,
    column_z: wp.vec4,
):
    """Version of `scatter` with vector instructions of a CPU."""
    ...


@wp.func_native(code("liquid", "liquid:volume"))
def scatter_volume_rows(
    fills: wp.array(dtype=wp.vec2), size: wp.vec3i, first: int, t: wp.vec3, volume: wp.float32
):
    """Version of `scatter_volume` with vector instructions of a CPU."""
    ...


@wp.func_native(code("liquid", "liquid:rows", "liquid:gather"))
def gather_rows(
    velocity: wp.array(dtype=wp.vec4), size: wp.vec3i, first: int, t: wp.vec3
) -> wp.mat44:
    """Version of `gather` with vector instructions of a CPU."""
    ...


@wp.func_native(code("liquid", "liquid:rows", "liquid:flow"))
def flow_rows(velocity: wp.array(dtype=wp.vec4), size: wp.vec3i, first: int, t: wp.vec3) -> wp.vec3:
    """Version of `flow` with vector instructions of a CPU."""
    ...


@wp.func
def counted(x: Any):
    """Return the vector (0, 1, 2, 3) in the precision of x."""
    return wp.vector(type(x)(0.0), type(x)(1.0), type(x)(2.0), type(x)(3.0))


@wp.func
def lowest(here: wp.vec3i, size: wp.vec3i):
    """Return the index of the lowest of the 4 x 4 x 4 cells around the cell `here`."""
    return number(here - wp.vec3i(1, 1, 1), size)


@wp.func
def within(s: Any, here: wp.vec3i):
    """Return the offset of a point from the lowest corner of its cell."""
    return wp.vector(
        s[0] - type(s[0])(here[0]), s[1] - type(s[0])(here[1]), s[2] - type(s[0])(here[2])
    )


FORMS = {
    "plain": (scatter, scatter_volume, gather, flow),
    "simd": (scatter_rows, scatter_volume_rows, gather_rows, flow_rows),
}


@build_once
def make_scatter(real: Any, form: str):
    """Kernel: adds mass, momentum and volume of particles to the cells' sums."""
    vec8 = sums(real)
    add = FORMS[form][0]

    @kernel(f"phy124_liquid_scatter_{real.__name__}_{form}", real, seconds=0.8)
    def liquid_scatter(mass, volume, lattice, window, x, v, C, cells_out: wp.array(dtype=vec8)):
        p = wp.tid()
        s = local(x[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        if inner(here, size, 2):
            low = here - wp.vec3i(1, 1, 1)
            m = mass[p]
            grad = (m * lattice[3]) * C[p]
            cx = wp.vector(grad[0, 0], grad[1, 0], grad[2, 0], real(0.0))
            cy = wp.vector(grad[0, 1], grad[1, 1], grad[2, 1], real(0.0))
            cz = wp.vector(grad[0, 2], grad[1, 2], grad[2, 2], real(0.0))
            u = v[p]
            base = wp.vector(m * u[0], m * u[1], m * u[2], volume[p])
            base += wp.cw_mul(cx, offset(s, low, 0))
            base += wp.cw_mul(cy, offset(s, low, 1))
            base += wp.cw_mul(cz, offset(s, low, 2))
            add(cells_out, size, lowest(here, size), within(s, here), m, base, cx, cy, cz)

    return liquid_scatter


@build_once
def make_scatter_volume(real: Any, form: str):
    """Kernel: adds the particles' volumes to the sums `FILL` and `HAT` of the cells."""
    add = FORMS[form][1]

    @kernel(f"phy124_liquid_scatter_volume_{real.__name__}_{form}", real, seconds=0.5)
    def liquid_scatter_volume(volume, lattice, window, x, fills_out):
        p = wp.tid()
        s = local(x[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        if inner(here, size, 2):
            add(fills_out, size, lowest(here, size), within(s, here), volume[p])

    return liquid_scatter_volume


@build_once
def make_gather(real: Any, form: str):
    """Kernel: gathers the velocity and its gradient from the faces, then moves the particles.

    Positions follow the flow of the faces (midpoint rule). A single drop, or a particle outside the
    window, moves along a parabola. The kernel also updates the deformation gradient that the
    Gaussians follow.
    """
    t = types(real)
    _, _, collect, carry = FORMS[form]

    @kernel(f"phy124_liquid_gather_{real.__name__}_{form}", real, seconds=0.8)
    def liquid_gather(
        lattice,
        window,
        clock,
        values,
        velocity,
        x_out,
        residue_out,
        v_out,
        C_out,
        total_out,
        missed_out: Ints,
    ):
        p = wp.tid()
        s = local(x_out[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        dx = lattice[3]
        dt = clock[1]
        a = values[0]
        pull = clock[0] * wp.vector(a[0], a[1], a[2])
        inside = inner(here, size, 3)
        v = v_out[p] + pull
        C = t.mat33()
        fill = real(0.0)
        if inside:
            low = here - wp.vec3i(1, 1, 1)
            rows = collect(velocity, size, lowest(here, size), within(s, here))
            mean = rows[0]
            fill = mean[3]
            if fill >= real(LONE):
                by_x = rows[1] + wp.cw_mul(offset(s, low, 0), mean)
                by_y = rows[2] + wp.cw_mul(offset(s, low, 1), mean)
                by_z = rows[3] + wp.cw_mul(offset(s, low, 2), mean)
                k4 = real(4.0) / dx
                C = k4 * wp.matrix_from_cols(
                    wp.vector(by_x[0], by_x[1], by_x[2]),
                    wp.vector(by_y[0], by_y[1], by_y[2]),
                    wp.vector(by_z[0], by_z[1], by_z[2]),
                )
                v = wp.vector(mean[0], mean[1], mean[2])
        drift = v
        if fill >= real(LONE):
            first = carry(velocity, size, lowest(here, size), within(s, here))
            middle = s + (real(0.5) * dt / dx) * first
            there = cell_at(middle)
            if inner(there, size, 2):
                drift = carry(velocity, size, lowest(there, size), within(middle, there))
        if not inside:
            wp.atomic_max(missed_out, 0, 1)
        # Kahan's compensated summation; otherwise, rounding in float32 would stop a slow motion.
        change = dt * drift - residue_out[p]
        moved = x_out[p] + change
        residue_out[p] = (moved - x_out[p]) - change
        x_out[p] = moved
        v_out[p] = v
        C_out[p] = C
        if total_out.shape[0] > 0:
            total_out[p] = total_out[p] + dt * (C * total_out[p])

    return liquid_gather


@build_once
def make_displace(real: Any, form: str):
    """Kernel: moves particles by a field of displacements [m], without changing velocities."""
    t = types(real)
    carry = FORMS[form][3]

    @kernel(f"phy124_liquid_displace_{real.__name__}_{form}", real, seconds=0.4)
    def liquid_displace(lattice, window, shifts: t.vec4s, x_out):
        p = wp.tid()
        s = local(x_out[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        if inner(here, size, 3):
            x_out[p] = x_out[p] + carry(shifts, size, lowest(here, size), within(s, here))

    return liquid_displace
