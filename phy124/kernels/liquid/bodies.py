"""Couples particle bodies to a liquid: terms of the pressure equation, and the pressure on bodies.

A body moves rigidly (`solids`). In addition, the change of the pressure since the last step
accelerates the body's surface like a layer with mass (a Robin condition: Fernandez, Mullaert and
Vidrascu 2013). Without this response, the deformation of a light or soft body would become
unstable.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.liquid.faces import cell_at, cell_of, entry, inner, local, number, stride
from phy124.kernels.liquid.impulses import Sums, take_row
from phy124.kernels.liquid.shapes import spline
from phy124.kernels.liquid.solids import put_motion
from phy124.kernels.liquid.walls import centre_of

MOMENTS = 16
"""Number of sums for each body: mass, mass times position [3], momentum [3], angular momentum about
the origin [3], and second moments of the mass xx, yy, zz, xy, xz, yz.
"""
LIGHT = wp.constant(0.02)
"""Smallest mass of a body's surface layer, relative to the mass of a cell full of liquid."""
Motions = wp.array2d(dtype=wp.vec3d)
Row = wp.types.vector(MOMENTS, wp.float64)


@build_once
def make_moments(real: Any):
    """Kernel: sums mass, momentum and moments over the particles of a body."""

    @kernel(f"phy124_liquid_moments_{real.__name__}", real, seconds=0.3)
    def moments(first, each, stride, count, dx, mass, x, v, C, rows_out: Doubles):
        sums = Row()
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < count:
                m = wp.float64(mass[p])
                X = wide(x[p])
                V = wide(v[p])
                spin = wp.vector(
                    C[p][2, 1] - C[p][1, 2], C[p][0, 2] - C[p][2, 0], C[p][1, 0] - C[p][0, 1]
                )
                L = wp.cross(X, V) + wide(real(0.25) * dx * dx * spin)
                sums[0] += m
                for a in range(3):
                    sums[1 + a] += m * X[a]
                    sums[4 + a] += m * V[a]
                    sums[7 + a] += m * L[a]
                    sums[10 + a] += m * X[a] * X[a]
                sums[13] += m * X[0] * X[1]
                sums[14] += m * X[0] * X[2]
                sums[15] += m * X[1] * X[2]
        for k in range(MOMENTS):
            wp.atomic_add(rows_out, k, sums[k])

    return moments


@wp.func
def heavier(n: int, axis: int, row: wp.float64, sheet: wp.array(dtype=Any), size: wp.vec3i):
    """Return which of two cells contains more mass of a body's surface.

    The cells are `n`, and the next cell behind the more open face of `n`. `row` is positive if the
    low face of `n` is more open than its high face.
    """
    m = n - stride(axis, size)
    if row > wp.float64(0.0):
        m = n + stride(axis, size)
    return wp.where(sheet[m][3] > sheet[n][3], m, n)


@build_once
def make_yield(real: Any):
    """Kernel over cells: adds motion and surface response of bodies to the pressure equation.

    `free` is the number of rigid solids, which are numbered before the first body; `scale` is rho
    dx^3 [kg]. `present` contains the rigid motions of all solids at the start of the step, and
    `x_guess` the last solution. The mass of a surface layer is the surface's mass plus `stiffness`
    dt^2 [kg].
    """

    @kernel(f"phy124_liquid_yield_{real.__name__}", real, seconds=0.4)
    def surface_yield(
        worker,
        active,
        ends,
        free: int,
        scale: wp.float64,
        lattice,
        window,
        clock,
        stiffness: Doubles,
        which,
        jumps,
        sheet,
        present: Motions,
        centres,
        x_guess: Doubles,
        diagonal_out: Doubles,
        right_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        solid = which[n]
        if solid < free:
            return
        size = window[1]
        row = jumps[n]
        for axis in range(3):
            if row[axis] != wp.float64(0.0):
                m = heavier(n, axis, row[axis], sheet, size)
                mass = wp.float64(sheet[m][3])
                if mass > wp.float64(0.0):
                    arm = wide(centre_of(cell_of(m, size), lattice, window[0])) - centres[solid]
                    rigid = present[solid, 0] + wp.cross(present[solid, 1], arm)
                    other = wp.float64(sheet[m][axis]) / mass - rigid[axis]
                    response = scale * row[axis] * row[axis]
                    dt = wp.float64(clock[0])
                    heavy = mass + stiffness[solid - free] * dt * dt
                    response /= wp.max(heavy, wp.float64(LIGHT) * scale)
                    diagonal_out[n] = diagonal_out[n] + response
                    right_out[n] = right_out[n] - row[axis] * other + response * x_guess[n]

    return surface_yield


@build_once
def make_answer(real: Any):
    """Kernel over solids and bodies: writes their rigid motions; sums the impulses of the pressure.

    `impulses_out` contains the impulse on each solid or body, and its moment about the origin.
    """

    @kernel(f"phy124_liquid_answer_{real.__name__}", real, seconds=0.3)
    def answer(
        wall,
        scale: wp.float64,
        plans: Motions,
        centres,
        mobility: wp.array2d(dtype=wp.float64),
        sums_out: Sums,
        motions_out,
        impulses_out: Motions,
    ):
        solid = wp.tid()
        row = take_row(sums_out, wall + solid)
        J = wp.vec3d(row[0], row[1], row[2])
        moment = wp.vec3d(row[3], row[4], row[5])
        impulses_out[solid, 0] = impulses_out[solid, 0] - J
        impulses_out[solid, 1] = impulses_out[solid, 1] - moment
        force = impulses_out[solid, 0] / scale
        turn = (impulses_out[solid, 1] - wp.cross(centres[solid], impulses_out[solid, 0])) / scale
        w = plans[solid, 1]
        for a in range(3):
            for b in range(3):
                w[a] += mobility[solid, 1 + 3 * a + b] * turn[b]
        V = plans[solid, 0] + mobility[solid, 0] * force
        put_motion(motions_out, wall + solid, V, w, centres[solid])

    return answer


@build_once
def make_body_change(real: Any):
    """Kernel over a region's cells: computes a body's velocity change by the pressure [m/s].

    `pressed` contains the impulse on the surface in each cell.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_change_{real.__name__}", real, seconds=0.3)
    def body_change(window, region, sheet, pressed: t.vec3s, jumps, change_out: t.vec3s):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 1):
            return
        m = number(cell, size)
        mass = sheet[m][3]
        if mass <= real(0.0):
            return
        total = t.vec3()
        for axis in range(3):
            for side in range(3):
                n = m + (side - 1) * stride(axis, size)
                if pressed[n][axis] != real(0.0):
                    if heavier(n, axis, jumps[n][axis], sheet, size) == m:
                        total[axis] += pressed[n][axis]
        change_out[m] = total / mass

    return body_change


@build_once
def make_body_gather(real: Any):
    """Kernel: computes the rates of change of v and C of a body's particles due to the pressure.

    The particles receive the same momentum and angular momentum as the cells. `most_out` is the
    largest acceleration [m/s^2].
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_gather_{real.__name__}", real, seconds=0.3)
    def body_gather(
        ahead: real,
        duration: real,
        lattice,
        window,
        x,
        v,
        change: t.vec3s,
        pushes_out: t.vec3s,
        turns_out: t.mat33s,
        most_out: t.reals,
    ):
        p = wp.tid()
        size = window[1]
        place = x[p] + ahead * v[p]
        s = local(place, lattice, window)
        cell = cell_at(s)
        total = t.vec3()
        turn = t.mat33()
        if inner(cell, size, 2):
            for a in range(3):
                for b in range(3):
                    for c in range(3):
                        at = cell + wp.vec3i(a - 1, b - 1, c - 1)
                        there = spline(s, cell, a, b, c) * change[number(at, size)]
                        total += there
                        turn += wp.outer(there, centre_of(at, lattice, window[0]) - place)
        pushes_out[p] = total / duration
        turns_out[p] = real(4.0) / (lattice[3] * lattice[3] * duration) * turn
        wp.atomic_max(most_out, 0, wp.length(total) / duration)

    return body_gather


@build_once
def make_body_push(real: Any):
    """Kernel: accelerates particles by the pressure that the liquid exerts on them."""
    t = types(real)

    @kernel(f"phy124_liquid_body_push_{real.__name__}", real, seconds=0.2)
    def body_push(clock, pushes: t.vec3s, turns: t.mat33s, v_out, C_out):
        p = wp.tid()
        v_out[p] = v_out[p] + clock[0] * pushes[p]
        C_out[p] = C_out[p] + clock[0] * turns[p]

    return body_push
