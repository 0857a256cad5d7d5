"""Bodies of particles in a liquid: their shape as a wall, and the push of the pressure on them.

The distance from a body's surface follows from the share of each cell that the body fills, as that
from the surface of the liquid does (`surface`). This rounds edges off, so the surface is shifted
outwards until the volume inside is the body's. The pressure gives a body two responses: that of
its rigid motion (`solids`), and that of the layer of mass at its surface to the change of the
pressure since the last step (a Robin condition: Fernandez, Mullaert and Vidrascu 2013). The second
one is zero at rest; without it, the deformation of a light or soft body would become unstable.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, Doubles, Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.conjugate import Vectors
from phy124.kernels.liquid.faces import cell_at, cell_of, entry, inner, local, number, stride
from phy124.kernels.liquid.impulses import Sums, take_row
from phy124.kernels.liquid.solids import put_motion
from phy124.kernels.liquid.surface import depth
from phy124.kernels.liquid.walls import GAP, SHUT, centre_of, halves, solid_face, square

MOMENTS = 16
"""Sums of a body: mass, mass times position [3], momentum [3], angular momentum about the origin
[3], and second moments of the mass xx, yy, zz, xy, xz, yz.
"""
LIGHT = wp.constant(0.02)
"""Smallest mass of a body's surface layer, relative to that of a cell full of liquid."""
Motions = wp.array2d(dtype=wp.vec3d)
Row = wp.types.vector(MOMENTS, wp.float64)


@cache
def make_moments(real: Any):
    """Kernel: sums mass, momentum and moments over the particles of a body.

    Angular momentum includes that of the particles' C (Jiang et al. 2015).
    """

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
def spline(s: Any, cell: wp.vec3i, a: int, b: int, c: int):
    """Return the quadratic B-spline of the cell (a, b, c) - 1 next to `cell` at a point."""
    weight = type(s[0])(1.0)
    at = wp.vec3i(a, b, c)
    for axis in range(3):
        d = wp.abs(s[axis] - type(s[0])(cell[axis] + at[axis]) + type(s[0])(0.5))
        if d < type(s[0])(0.5):
            weight *= type(s[0])(0.75) - d * d
        else:
            far = wp.max(type(s[0])(1.5) - d, type(s[0])(0.0))
            weight *= type(s[0])(0.5) * far * far
    return weight


@cache
def make_body_scatter(real: Any):
    """Kernel: adds momentum, mass and volume of a body's particles to the cells.

    Positions are those that the velocities lead to in the time `ahead` [s].
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_scatter_{real.__name__}", real, seconds=0.4)
    def body_scatter(
        ahead: real,
        lattice,
        window,
        mass,
        volume,
        x,
        v,
        C,
        F,
        sheet_out: t.vec4s,
        full_out: t.reals,
    ):
        p = wp.tid()
        size = window[1]
        place = x[p] + ahead * v[p]
        s = local(place, lattice, window)
        cell = cell_at(s)
        if not inner(cell, size, 2):
            return
        filled = volume[p] * wp.clamp(wp.determinant(F[p]), real(0.1), real(3.0))
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    at = cell + wp.vec3i(a - 1, b - 1, c - 1)
                    w = spline(s, cell, a, b, c)
                    n = number(at, size)
                    there = v[p] + C[p] @ (centre_of(at, lattice, window[0]) - place)
                    m = w * mass[p]
                    row = wp.vector(m * there[0], m * there[1], m * there[2], m)
                    wp.atomic_add(sheet_out, n, row)
                    wp.atomic_add(full_out, n, w * filled)

    return body_scatter


@wp.func
def eighth(cell: wp.vec3i, a: int, b: int, c: int, like: Any):
    """Return the centre of an eighth of a cell, in cells from the window's corner."""
    half = type(like)(0.5)
    quarter = type(like)(0.25)
    return wp.vector(
        type(like)(cell[0]) + quarter + half * type(like)(a),
        type(like)(cell[1]) + quarter + half * type(like)(b),
        type(like)(cell[2]) + quarter + half * type(like)(c),
    )


@cache
def make_body_level(real: Any):
    """Kernel over the cells of a region: computes the distance from a body's surface [cells].

    The surface is shifted outwards by `shift` [cells]. The body's volume [cells] is added to
    `volumes_out`.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_level_{real.__name__}", real, seconds=0.3)
    def body_level(
        shift: real,
        lattice,
        window,
        region: Box,
        full: t.reals,
        level_out: t.reals,
        volumes_out: Doubles,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        if inner(cell, window[1], 0):
            n = number(cell, window[1])
            dx = lattice[3]
            fill = full[n] / (dx * dx * dx)
            if fill > real(0.0):
                level_out[n] = -depth(fill) - shift
                wp.atomic_add(volumes_out, 0, wp.float64(fill))

    return body_level


@wp.func
def level_at(level: wp.array(dtype=Any), s: Any, size: wp.vec3i):
    """Return the distance from a body [cells] at a point, linear between the centres of cells."""
    half = type(s[0])(0.5)
    low = cell_at(s - wp.vector(half, half, half))
    total = type(s[0])(EMPTY)
    if inner(low, size, 1):
        total = type(s[0])(0.0)
        u = s - wp.vector(half, half, half)
        u -= wp.vector(type(s[0])(low[0]), type(s[0])(low[1]), type(s[0])(low[2]))
        unit = type(s[0])(1.0)
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    w = wp.where(a == 1, u[0], unit - u[0]) * wp.where(b == 1, u[1], unit - u[1])
                    w *= wp.where(c == 1, u[2], unit - u[2])
                    total += w * level[number(low + wp.vec3i(a, b, c), size)]
    return total


@cache
def make_body_volume(real: Any):
    """Kernel over the cells of a region: sums the volume inside a body's surface [cells].

    `volumes_out` also gets the change of this volume per cell by which the surface is shifted.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_volume_{real.__name__}", real, seconds=0.3)
    def body_volume(window, region: Box, level: t.reals, volumes_out: Doubles):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        here = level[number(cell, size)]
        if here >= real(EMPTY):
            return
        half = real(0.5)
        inside = real(0.0)
        slope = real(0.0)
        parts = int(2)
        for a in range(parts):
            for b in range(parts):
                for c in range(parts):
                    d = level_at(level, eighth(cell, a, b, c, here), size)
                    share = half - real(2.0) * d
                    inside += real(0.125) * wp.clamp(share, real(0.0), real(1.0))
                    if share > real(0.0) and share < real(1.0):
                        slope += real(0.25)
        wp.atomic_add(volumes_out, 1, wp.float64(inside))
        wp.atomic_add(volumes_out, 2, wp.float64(slope))

    return body_volume


@cache
def make_body_distance(real: Any):
    """Kernel over points at half the spacing: stores distances from a body if they are smaller."""
    t = types(real)

    @kernel(f"phy124_liquid_body_distance_{real.__name__}", real, seconds=0.3)
    def body_distance(
        wall: int,
        lattice,
        window,
        region: Box,
        level: t.reals,
        distances_out: t.reals,
        owners_out: Ints,
    ):
        at = cell_of(wp.tid(), halves(region[1])) + 2 * region[0]
        if not inner(at, halves(window[1]), 0):
            return
        n = number(at, halves(window[1]))
        half = real(0.5)
        s = wp.vector(half * real(at[0]), half * real(at[1]), half * real(at[2]))
        d = level_at(level, s, window[1])
        if d < real(0.98) * real(EMPTY) and d * lattice[3] < distances_out[n]:
            distances_out[n] = d * lattice[3]
            owners_out[n] = wall

    return body_distance


@cache
def make_body_openings(real: Any):
    """Kernel over the cells of a region: multiplies open shares by what a body leaves open.

    The shares are those of the low faces, and of the eighths of the cell.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_openings_{real.__name__}", real, seconds=0.5)
    def body_openings(window, region: Box, level: t.reals, open_out: t.vec4s, vacant_out: t.reals):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if level[n] >= real(EMPTY):
            return
        half = real(0.5)
        low = wp.vector(real(cell[0]), real(cell[1]), real(cell[2]))
        share = open_out[n]
        for axis in range(3):
            e = t.vec3()
            f = t.vec3()
            e[(axis + 1) % 3] = real(1.0)
            f[(axis + 2) % 3] = real(1.0)
            part = square(
                level_at(level, low, size),
                level_at(level, low + e, size),
                level_at(level, low + e + f, size),
                level_at(level, low + f, size),
                level_at(level, low + half * (e + f), size),
            )
            share[axis] = share[axis] * part
            if share[axis] < real(SHUT):
                share[axis] = real(0.0)
            if share[axis] > real(1.0) - real(SHUT):
                share[axis] = real(1.0)
        open_out[n] = share
        twice = 2 * size
        parts = int(2)
        for a in range(parts):
            for b in range(parts):
                for c in range(parts):
                    d = level_at(level, eighth(cell, a, b, c, half), size)
                    m = number(2 * cell + wp.vec3i(a, b, c), twice)
                    vacant_out[m] = vacant_out[m] * wp.clamp(
                        half + real(2.0) * d, real(0.0), real(1.0)
                    )

    return body_openings


@wp.func
def heavier(n: int, axis: int, row: wp.float64, sheet: wp.array(dtype=Any), size: wp.vec3i):
    """Return the cell at a surface that has more of the body's mass: `n`, or that behind the face.

    `row` is minus the difference of the open shares, positive if the low face is more open.
    """
    m = n - stride(axis, size)
    if row > wp.float64(0.0):
        m = n + stride(axis, size)
    return wp.where(sheet[m][3] > sheet[n][3], m, n)


@cache
def make_yield(real: Any):
    """Kernel over cells: adds the motion and response of the surfaces of bodies to the equation.

    `free` is the number of solids before the first body, `scale` is rho dx^3 [kg], and `present`
    has the rigid motions of all solids at the start of the step. `x_guess` holds the last solution.
    In a step of dt, a surface resists a change of the pressure like its mass plus `stiffness` dt^2
    [kg].
    """
    t = types(real)

    @kernel(f"phy124_liquid_yield_{real.__name__}", real, seconds=0.4)
    def surface_yield(
        worker: int,
        active: Ints,
        ends: Ints,
        free: int,
        scale: wp.float64,
        lattice,
        window,
        clock,
        stiffness: Doubles,
        which: Ints,
        jumps: Vectors,
        sheet: t.vec4s,
        present: Motions,
        centres: Vectors,
        x_guess: Doubles,
        diagonal_out: Doubles,
        right_out: Doubles,
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


@cache
def make_answer(real: Any):
    """Kernel over bodies: writes their rigid motions after the pressure, and sums its impulses.

    `given_out` has the impulse on each body and its moment about the origin.
    """
    t = types(real)

    @kernel(f"phy124_liquid_answer_{real.__name__}", real, seconds=0.3)
    def answer(
        wall: int,
        free: int,
        scale: wp.float64,
        plans: Motions,
        centres: Vectors,
        mobility: wp.array2d(dtype=wp.float64),
        sums_out: Sums,
        motions_out: wp.array2d(dtype=t.vec3),
        given_out: Motions,
    ):
        solid = free + wp.tid()
        row = take_row(sums_out, wall + solid)
        J = wp.vec3d(row[0], row[1], row[2])
        moment = wp.vec3d(row[3], row[4], row[5])
        given_out[solid, 0] = given_out[solid, 0] - J
        given_out[solid, 1] = given_out[solid, 1] - moment
        force = given_out[solid, 0] / scale
        turn = (given_out[solid, 1] - wp.cross(centres[solid], given_out[solid, 0])) / scale
        w = plans[solid, 1]
        for a in range(3):
            for b in range(3):
                w[a] += mobility[solid, 1 + 3 * a + b] * turn[b]
        V = plans[solid, 0] + mobility[solid, 0] * force
        put_motion(motions_out, wall + solid, V, w, centres[solid])

    return answer


@cache
def make_body_change(real: Any):
    """Kernel over the cells of a region: the change of a body's velocity by the pressure [m/s].

    `pressed` has the impulse on the surface in each cell, which acts on the mass at the surface.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_change_{real.__name__}", real, seconds=0.3)
    def body_change(
        window, region: Box, sheet: t.vec4s, pressed: t.vec3s, jumps: Vectors, change_out: t.vec3s
    ):
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


@cache
def make_contact(real: Any):
    """Kernel over the cells of a region: the area of a body that lies on walls which never move.

    `still` has the open shares without bodies. The rows have the signs of `make_jumps`.
    """
    t = types(real)

    @kernel(f"phy124_liquid_contact_{real.__name__}", real, seconds=0.2)
    def contact(
        window,
        region: Box,
        level: t.reals,
        still: t.vec4s,
        open: t.vec4s,
        contact_out: t.vec3s,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if level[n] >= real(EMPTY):
            return
        row = contact_out[n]
        for axis in range(3):
            m = n + stride(axis, size)
            wall = still[m][axis] - still[n][axis]
            if wall != real(0.0):
                row[axis] = wall - open[m][axis] + open[n][axis]
        contact_out[n] = row

    return contact


@cache
def make_head(real: Any):
    """Kernel over cells: sums the mean of q - a x dt / dx at the surface of a body.

    `rows_out` gets the sum over all cells of the body's surface, and its area.
    """

    @kernel(f"phy124_liquid_head_{real.__name__}", real, seconds=0.2)
    def head(
        solid: int,
        region: Box,
        lattice,
        window,
        clock,
        values,
        which: Ints,
        liquid: Ints,
        jumps: Vectors,
        x_guess: Doubles,
        rows_out: Doubles,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if liquid[n] == 1 and which[n] == solid:
            a = wp.vector(values[0][0], values[0][1], values[0][2])
            x = centre_of(cell, lattice, window[0])
            weight = wp.float64(clock[0] / lattice[3] * wp.dot(a, x))
            area = wp.length(jumps[n])
            wp.atomic_add(rows_out, 0, area * (x_guess[n] - weight))
            wp.atomic_add(rows_out, 1, area)

    return head


@cache
def make_film(real: Any):
    """Kernel over the cells of a region: pressure of a film of liquid between a body and walls.

    A body that lies on a wall has the hydrostatic pressure of the liquid around it there, too. In a
    cell of liquid between both, of which no face is more open than the opposite one, it has that of
    the cell.
    """
    t = types(real)

    @kernel(f"phy124_liquid_film_{real.__name__}", real, seconds=0.3)
    def film(
        solid: int,
        rise: real,
        scale: real,
        region: Box,
        lattice,
        window,
        clock,
        values,
        which: Ints,
        liquid: Ints,
        jumps: Vectors,
        x_guess: Doubles,
        owners: Ints,
        contact: t.vec3s,
        pressed_out: t.vec3s,
        sums_out: wp.array2d(dtype=wp.float64),
        exchanged_out: Motions,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        a = wp.vector(values[0][0], values[0][1], values[0][2])
        for axis in range(3):
            row = contact[n][axis]
            if row != real(0.0) and liquid[n] == 1 and which[n] == solid:
                row -= real(jumps[n][axis])
            if row != real(0.0):
                x = centre_of(cell, lattice, window[0])
                x[axis] = x[axis] - real(0.5) * lattice[3] * wp.sign(row)
                q = wp.max(rise + clock[0] / lattice[3] * wp.dot(a, x), real(0.0))
                if liquid[n] == 1:
                    q = real(x_guess[n])
                impulse = t.vec3()
                impulse[axis] = q * scale * row
                pressed_out[n] = pressed_out[n] + impulse
                moment = wide(wp.cross(x, impulse))
                wp.atomic_add(exchanged_out, solid, 0, wide(impulse))
                wp.atomic_add(exchanged_out, solid, 1, moment)
                wall = owners[solid_face(cell, axis, row, size)]
                if wall >= 0:
                    wp.atomic_add(sums_out, wall, axis, wp.float64(impulse[axis]))
                    for b in range(3):
                        wp.atomic_add(sums_out, wall, 3 + b, moment[b])

    return film


@cache
def make_body_gather(real: Any):
    """Kernel: computes the rates at which the pressure changes v and C of a body's particles.

    As in APIC, momentum and angular momentum are those of the cells. `most_out` is the largest
    acceleration [m/s^2].
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


@cache
def make_body_push(real: Any):
    """Kernel: accelerates particles by the pressure of the liquid."""
    t = types(real)

    @kernel(f"phy124_liquid_body_push_{real.__name__}", real, seconds=0.2)
    def body_push(clock, pushes: t.vec3s, turns: t.mat33s, v_out, C_out):
        p = wp.tid()
        v_out[p] = v_out[p] + clock[0] * pushes[p]
        C_out[p] = C_out[p] + clock[0] * turns[p]

    return body_push


@cache
def make_body_push_out(real: Any):
    """Kernel: moves particles of the liquid out of bodies; the first body has the number `wall`."""
    t = types(real)

    @kernel(f"phy124_liquid_body_push_out_{real.__name__}", real, seconds=0.4)
    def body_push_out(wall: int, lattice, window, distances: t.reals, owners: Ints, x_out):
        p = wp.tid()
        size = window[1]
        dx = lattice[3]
        s = local(x_out[p], lattice, window)
        if not inner(cell_at(s), size, 1):
            return
        near = number(cell_at(real(2.0) * s + t.vec3(real(0.5))), halves(size))
        if owners[near] < wall or distances[near] > dx:
            return
        low = cell_at(real(2.0) * s)
        u = real(2.0) * s - wp.vector(real(low[0]), real(low[1]), real(low[2]))
        d = real(0.0)
        slope = t.vec3()
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    at = wp.vec3i(a, b, c)
                    here = distances[number(low + at, halves(size))]
                    w = t.vec3()
                    for axis in range(3):
                        w[axis] = wp.where(at[axis] == 1, u[axis], real(1.0) - u[axis])
                    d += w[0] * w[1] * w[2] * here
                    for axis in range(3):
                        side = wp.where(at[axis] == 1, real(1.0), real(-1.0))
                        slope[axis] += side * w[(axis + 1) % 3] * w[(axis + 2) % 3] * here
        deep = real(GAP) * dx - d
        if deep > real(0.0) and wp.length(slope) > real(0.0):
            x_out[p] = x_out[p] + wp.min(deep, real(0.5) * dx) * wp.normalize(slope)

    return body_push_out


def kernels(real: Any) -> list[Any]:
    """Return the kernels of bodies in a liquid."""
    makers = (make_moments, make_body_scatter, make_body_level, make_body_volume)
    makers += (make_body_distance, make_contact, make_head, make_film)
    makers += (make_body_openings, make_yield, make_answer, make_body_change)
    makers += (make_body_gather, make_body_push, make_body_push_out)
    return [make(real) for make in makers]
