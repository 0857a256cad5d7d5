"""Transfers between particles and the faces of a staggered grid: APIC with quadratic B-splines.

The components of the velocity live at different points, so each has weights of its own. A particle
reaches 4 x 4 x 4 cells. A vector for each cell holds the values of its three low faces and of its
centre. Along an axis, the weights of these differ only by a shift of half a cell, which makes some
of the four weights zero (Jiang et al. 2015, "The affine particle-in-cell method").
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.transfer import spline

FILL = 3
"""Component of the volume with quadratic weights at the cell's centre [m^3]."""
HAT = 7
"""Component of the volume with linear weights at the cell's centre [m^3]."""


@cache
def sums(real: Any):
    """Return the type of a cell's sums: momentum of faces, fill, mass of faces, linear weight."""
    return wp.types.vector(8, real)


@wp.func
def cell_at(s: Any):
    """Return the cell that contains a point, in cells from the window's corner."""
    return wp.vec3i(int(wp.floor(s[0])), int(wp.floor(s[1])), int(wp.floor(s[2])))


@wp.func
def number(cell: wp.vec3i, size: wp.vec3i):
    """Return the index of a cell of the window."""
    return (cell[0] * size[1] + cell[1]) * size[2] + cell[2]


@wp.func
def cell_of(n: int, size: wp.vec3i):
    """Return the cell with an index."""
    row = n // size[2]
    i = row // size[1]
    return wp.vec3i(i, row - i * size[1], n - row * size[2])


@wp.func
def inner(cell: wp.vec3i, size: wp.vec3i, rim: int):
    """Return whether a cell is at least `rim` cells away from the window's border."""
    return (
        cell[0] >= rim
        and cell[1] >= rim
        and cell[2] >= rim
        and cell[0] < size[0] - rim
        and cell[1] < size[1] - rim
        and cell[2] < size[2] - rim
    )


@wp.func
def stride(axis: int, size: wp.vec3i):
    """Return the distance in memory between neighbouring cells along an axis."""
    step = 1
    if axis == 0:
        step = size[1] * size[2]
    if axis == 1:
        step = size[2]
    return step


@wp.func
def local(x: Any, lattice: Any, window: wp.array(dtype=wp.vec3i)):
    """Return a position in cells from the window's corner."""
    low = window[0]
    dx = lattice[3]
    return wp.vector(
        (x[0] - lattice[0]) / dx - type(dx)(low[0]),
        (x[1] - lattice[1]) / dx - type(dx)(low[1]),
        (x[2] - lattice[2]) / dx - type(dx)(low[2]),
    )


@wp.func
def at_centres(t: Any):
    """Return quadratic weights of four cells' centres; t is the offset in the second cell."""
    w = spline(t + type(t)(0.5))
    return wp.vector(w[0], w[1], w[2], type(t)(0.0))


@wp.func
def at_faces(t: Any):
    """Return quadratic weights of four cells' low faces; t is the offset in the second cell."""
    zero = type(t)(0.0)
    if t < type(t)(0.5):
        w = spline(t + type(t)(1.0))
        return wp.vector(w[0], w[1], w[2], zero)
    w = spline(t)
    return wp.vector(zero, w[0], w[1], w[2])


@wp.func
def at_hats(t: Any):
    """Return linear weights of four cells' centres; t is the offset in the second cell."""
    zero = type(t)(0.0)
    half = type(t)(0.5)
    if t < half:
        return wp.vector(half - t, half + t, zero, zero)
    return wp.vector(zero, type(t)(1.5) - t, t - half, zero)


@wp.func
def weights(t: Any, axis: int):
    """Return weights of four cells along an axis: a row per cell, a column per face and centre."""
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
    """Return distances along an axis from a particle to the first cell's three faces and centre."""
    half = type(s[0])(0.5)
    d = type(s[0])(low[axis]) - s[axis] + half
    result = wp.vector(d, d, d, d)
    result[axis] = d - half
    return result


@cache
def make_scatter(real: Any):
    """Kernel: adds mass, momentum and volume of particles to the cells' sums."""
    vec8 = sums(real)

    @kernel(f"phy124_liquid_scatter_{real.__name__}", real, seconds=0.8)
    def scatter(mass, volume, lattice, window, x, v, C, cells_out: wp.array(dtype=vec8)):
        p = wp.tid()
        s = local(x[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        if inner(here, size, 2):
            dx = lattice[3]
            low = here - wp.vec3i(1, 1, 1)
            tx = s[0] - real(here[0])
            ty = s[1] - real(here[1])
            tz = s[2] - real(here[2])
            wx = weights(tx, 0)
            wy = weights(ty, 1)
            wz = weights(tz, 2)
            hx = at_hats(tx)
            hy = at_hats(ty)
            hz = at_hats(tz)
            m = mass[p]
            vol = volume[p]
            grad = (m * dx) * C[p]
            cx = wp.vector(grad[0, 0], grad[1, 0], grad[2, 0], real(0.0))
            cy = wp.vector(grad[0, 1], grad[1, 1], grad[2, 1], real(0.0))
            cz = wp.vector(grad[0, 2], grad[1, 2], grad[2, 2], real(0.0))
            u = v[p]
            base = wp.vector(m * u[0], m * u[1], m * u[2], vol)
            base += wp.cw_mul(cx, offset(s, low, 0))
            base += wp.cw_mul(cy, offset(s, low, 1))
            base += wp.cw_mul(cz, offset(s, low, 2))
            step = wp.vector(real(0.0), real(1.0), real(2.0), real(3.0))
            for a in range(4):
                for b in range(4):
                    w = wp.cw_mul(wx[a], wy[b])
                    value = base + step[a] * cx + step[b] * cy
                    hat = vol * hx[a] * hy[b]
                    n = number(low + wp.vec3i(a, b, 0), size)
                    for c in range(4):
                        ww = wp.cw_mul(w, wz[c])
                        q = wp.cw_mul(ww, value + step[c] * cz)
                        wp.atomic_add(
                            cells_out,
                            n + c,
                            vec8(
                                q[0],
                                q[1],
                                q[2],
                                q[3],
                                m * ww[0],
                                m * ww[1],
                                m * ww[2],
                                hat * hz[c],
                            ),
                        )

    return scatter


@cache
def make_scatter_volume(real: Any):
    """Kernel: adds the volume of particles to the fill and hat of the cells."""
    t = types(real)

    @kernel(f"phy124_liquid_scatter_volume_{real.__name__}", real, seconds=0.5)
    def scatter_volume(volume, lattice, window, x, fills_out: t.vec2s):
        p = wp.tid()
        s = local(x[p], lattice, window)
        size = window[1]
        here = cell_at(s)
        if inner(here, size, 2):
            low = here - wp.vec3i(1, 1, 1)
            tx = s[0] - real(here[0])
            ty = s[1] - real(here[1])
            tz = s[2] - real(here[2])
            wx = at_centres(tx)
            wy = at_centres(ty)
            wz = at_centres(tz)
            hx = at_hats(tx)
            hy = at_hats(ty)
            hz = at_hats(tz)
            vol = volume[p]
            for a in range(3):
                for b in range(3):
                    w = vol * wx[a] * wy[b]
                    h = vol * hx[a] * hy[b]
                    n = number(low + wp.vec3i(a, b, 0), size)
                    for c in range(3):
                        wp.atomic_add(fills_out, n + c, wp.vector(w * wz[c], h * hz[c]))

    return scatter_volume


@wp.func
def flow(velocity: wp.array(dtype=Any), size: wp.vec3i, s: Any):
    """Return the velocity at a point, by linear interpolation of each component; s in cells."""
    half = type(s[0])(0.5)
    unit = type(s[0])(1.0)
    result = s
    for axis in range(3):
        at = s - wp.vector(half, half, half)
        at[axis] += half
        i = cell_at(at)
        f = at[0] - type(half)(i[0])
        g = at[1] - type(half)(i[1])
        h = at[2] - type(half)(i[2])
        n = number(i, size)
        dx = size[1] * size[2]
        dy = size[2]
        near = (unit - g) * ((unit - h) * velocity[n][axis] + h * velocity[n + 1][axis]) + g * (
            (unit - h) * velocity[n + dy][axis] + h * velocity[n + dy + 1][axis]
        )
        far = (unit - g) * (
            (unit - h) * velocity[n + dx][axis] + h * velocity[n + dx + 1][axis]
        ) + g * ((unit - h) * velocity[n + dx + dy][axis] + h * velocity[n + dx + dy + 1][axis])
        result[axis] = (unit - f) * near + f * far
    return result


LONE = wp.constant(0.3)
"""Fill below which a particle is a drop in flight, which no pressure of its own cell moves."""


@cache
def make_gather(real: Any):
    """Kernel: gathers velocity and its gradient from the faces, then moves the particles.

    Positions follow the flow of the faces (midpoint rule). A drop that is alone, or outside the
    window, flies on a parabola. The deformation gradient that the Gaussians follow is updated.
    """
    t = types(real)

    @kernel(f"phy124_liquid_gather_{real.__name__}", real, seconds=0.8)
    def gather(
        lattice,
        window,
        clock,
        values,
        velocity: t.vec4s,
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
            wx = weights(s[0] - real(here[0]), 0)
            wy = weights(s[1] - real(here[1]), 1)
            wz = weights(s[2] - real(here[2]), 2)
            mean = t.vec4()
            by_x = t.vec4()
            by_y = t.vec4()
            by_z = t.vec4()
            step = wp.vector(real(0.0), real(1.0), real(2.0), real(3.0))
            for i in range(4):
                for j in range(4):
                    n = number(low + wp.vec3i(i, j, 0), size)
                    row = t.vec4()
                    along = t.vec4()
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
            fill = mean[3]
            if fill >= real(LONE):
                by_x += wp.cw_mul(offset(s, low, 0), mean)
                by_y += wp.cw_mul(offset(s, low, 1), mean)
                by_z += wp.cw_mul(offset(s, low, 2), mean)
                k4 = real(4.0) / dx
                C = k4 * wp.matrix_from_cols(
                    wp.vector(by_x[0], by_x[1], by_x[2]),
                    wp.vector(by_y[0], by_y[1], by_y[2]),
                    wp.vector(by_z[0], by_z[1], by_z[2]),
                )
                v = wp.vector(mean[0], mean[1], mean[2])
        drift = v
        if fill >= real(LONE):
            first = flow(velocity, size, s)
            middle = s + (real(0.5) * dt / dx) * first
            if inner(cell_at(middle), size, 2):
                drift = flow(velocity, size, middle)
        if not inside:
            wp.atomic_max(missed_out, 0, 1)
        # Kahan's compensated sum: without it, rounding in float32 would stop a slow drift.
        change = dt * drift - residue_out[p]
        moved = x_out[p] + change
        residue_out[p] = (moved - x_out[p]) - change
        x_out[p] = moved
        v_out[p] = v
        C_out[p] = C
        if total_out.shape[0] > 0:
            total_out[p] = total_out[p] + dt * (C * total_out[p])

    return gather


@cache
def make_displace(real: Any):
    """Kernel: moves particles by a field of displacements [m], without changing velocities."""
    t = types(real)

    @kernel(f"phy124_liquid_displace_{real.__name__}", real, seconds=0.4)
    def displace(lattice, window, shifts: t.vec4s, x_out):
        p = wp.tid()
        s = local(x_out[p], lattice, window)
        size = window[1]
        if inner(cell_at(s), size, 3):
            dx = lattice[3]
            first = flow(shifts, size, s)
            middle = s + (real(0.5) / dx) * first
            if inner(cell_at(middle), size, 2):
                x_out[p] = x_out[p] + flow(shifts, size, middle)

    return displace


@cache
def make_sum_copies(real: Any):
    """Kernel over cells: adds the sums of all other copies of the cells to the first copy.

    Copies are added in their order, so that the result depends only on their number.
    """
    vec8 = sums(real)

    @kernel(f"phy124_liquid_sum_copies_{real.__name__}", real, seconds=0.2)
    def sum_copies(first, count, copies: int, cells_out: wp.array(dtype=vec8)):
        n = first + wp.tid()
        total = cells_out[n]
        for c in range(1, copies):
            total += cells_out[c * count + n]
        cells_out[n] = total

    return sum_copies


@cache
def make_sum_fills(real: Any):
    """Kernel over cells: adds the volumes of all other copies of the cells to the first copy."""
    t = types(real)

    @kernel(f"phy124_liquid_sum_fills_{real.__name__}", real, seconds=0.2)
    def sum_fills(first, count, copies: int, fills_out: t.vec2s):
        n = first + wp.tid()
        total = fills_out[n]
        for c in range(1, copies):
            total += fills_out[c * count + n]
        fills_out[n] = total

    return sum_fills


@cache
def make_extent(real: Any):
    """Kernel: computes the bounding box of the particles and their largest squared speed.

    The lowest corner is stored as the maximum of -x. Thread n reads the particles n `first` +
    k `stride`, k < `each`.
    """
    t = types(real)
    vec7 = wp.types.vector(7, real)

    @kernel(f"phy124_liquid_extent_{real.__name__}", real, seconds=0.3)
    def extent(first, each, stride, count, x, v, maxima_out: t.reals, stray_out: Ints):
        most = vec7()
        for i in range(6):
            most[i] = real(-wp.inf)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < count:
                here = x[p]
                fast = wp.dot(v[p], v[p])
                if fast + wp.dot(here, here) < real(wp.inf):
                    for axis in range(3):
                        most[axis] = wp.max(most[axis], -here[axis])
                        most[3 + axis] = wp.max(most[3 + axis], here[axis])
                    most[6] = wp.max(most[6], fast)
                else:
                    wp.atomic_add(stray_out, 0, 1)
        for i in range(7):
            wp.atomic_max(maxima_out, i, most[i])

    return extent
