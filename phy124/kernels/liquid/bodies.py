"""Bodies of particles in a liquid: their terms of the pressure equation, and the pressure on them.

The pressure gives a body two responses: that of its rigid motion (`solids`), and that of the layer
of mass at its surface to the change of the pressure since the last step (a Robin condition:
Fernandez, Mullaert and Vidrascu 2013). The response of the layer is zero at rest; without this
response, the deformation of a light or soft body would become unstable.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, Doubles, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.liquid import shapes
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.conjugate import Vectors
from phy124.kernels.liquid.faces import cell_at, cell_of, entry, inner, local, number, stride
from phy124.kernels.liquid.impulses import Sums, take_row
from phy124.kernels.liquid.mixture import CENTRE
from phy124.kernels.liquid.shapes import spline
from phy124.kernels.liquid.solids import put_motion
from phy124.kernels.liquid.walls import centre_of, solid_face

MOMENTS = 16
"""Number of sums for each body: mass, mass times position [3], momentum [3], angular momentum about
the origin [3], and second moments of the mass xx, yy, zz, xy, xz, yz."""
LIGHT = wp.constant(0.02)
"""Smallest mass of a body's surface layer, relative to the mass of a cell full of liquid."""
Motions = wp.array2d(dtype=wp.vec3d)
Row = wp.types.vector(MOMENTS, wp.float64)


@build_once
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
def heavier(n: int, axis: int, row: wp.float64, sheet: wp.array(dtype=Any), size: wp.vec3i):
    """Return, of the cell `n` and the next cell behind its more open face, the one with more mass.

    `row` is positive if the low face of the two opposite faces is more open.
    """
    m = n - stride(axis, size)
    if row > wp.float64(0.0):
        m = n + stride(axis, size)
    return wp.where(sheet[m][3] > sheet[n][3], m, n)


@build_once
def make_yield(real: Any):
    """Kernel over cells: adds the bodies' surface motion and response to the pressure equation.

    `free` is the number of solids before the first body, `scale` is rho dx^3 [kg], and `present`
    has the rigid motions of all solids at the start of the step. `x_guess` holds the last solution.
    In a step of length dt, a surface responds to a change of the pressure like a mass: its own plus
    `stiffness` dt^2 [kg].
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


@build_once
def make_answer(real: Any):
    """Kernel over bodies: writes the rigid motions that pressure causes, and sums its impulses.

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


@build_once
def make_body_change(real: Any):
    """Kernel over a region's cells: computes a body's velocity change by the pressure [m/s].

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


@build_once
def make_contact(real: Any):
    """Kernel over a region's cells: computes the area of a body's contact with fixed walls.

    `still` has the open share of each face if bodies are ignored. The areas have the same signs as
    the rows that `make_jumps` writes.
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


@build_once
def make_layers(real: Any):
    """Kernel over a region's cells: sums densities, and counts cells, in layers across `up`.

    `low` is the height of the first layer [cells].
    """
    t = types(real)

    @kernel(f"phy124_liquid_layers_{real.__name__}", real, seconds=0.2)
    def layers(
        up: t.vec3,
        low: real,
        region: Box,
        lattice,
        window,
        densities: t.vec4s,
        liquid: Ints,
        layers_out: wp.array(dtype=wp.vec2d),
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if liquid[n] == 1:
            height = wp.dot(up, centre_of(cell, lattice, window[0])) / lattice[3] - low
            k = wp.clamp(int(wp.floor(height)), 0, layers_out.shape[0] - 1)
            dense = wp.float64(densities[n][CENTRE])
            wp.atomic_add(layers_out, k, wp.vec2d(dense, wp.float64(1.0)))

    return layers


@wp.func
def weight_at(x: Any, a: Any, dt: Any, dx: Any, low: Any, heads: wp.array(dtype=Any)):
    """Return the hydrostatic q at a point, up to a constant.

    `heads` has the weight of the liquid below each layer, relative to the mean density; it is empty
    if there is a single density.
    """
    if heads.shape[0] == 0:
        return dt / dx * wp.dot(a, x)
    pull = wp.length(a)
    if pull == type(dx)(0.0):
        return type(dx)(0.0)
    height = -wp.dot(a, x) / (pull * dx) - low
    k = wp.clamp(int(wp.floor(height)), 0, heads.shape[0] - 2)
    below = heads[k] + (height - type(dx)(k)) * (heads[k + 1] - heads[k])
    return -dt * pull * below


@build_once
def make_head(real: Any):
    """Kernel over cells: sums q less its hydrostatic part around a body's contact with walls.

    A contact's direction is that in which a film pushes the body: -x, +x, -y, +y, -z or +z.
    `rows_out` [6] has three numbers for each direction: the sum, over the cells next to the
    contact, weighted by the area of the body's surface in each cell; the total of these areas; and
    the area of the contact.
    """
    t = types(real)

    @kernel(f"phy124_liquid_head_{real.__name__}", real, seconds=0.2)
    def head(
        solid: int,
        low: real,
        heads: t.reals,
        region: Box,
        lattice,
        window,
        clock,
        values,
        which: Ints,
        liquid: Ints,
        jumps: Vectors,
        x_guess: Doubles,
        contact: t.vec3s,
        rows_out: Vectors,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        zero = wp.float64(0.0)
        for axis in range(3):
            touch = wp.float64(contact[n][axis])
            if touch != zero:
                side = 2 * axis + int(touch > zero)
                wp.atomic_add(rows_out, side, wp.vec3d(zero, zero, wp.abs(touch)))
        if liquid[n] == 1 and which[n] == solid:
            a = wp.vector(values[0][0], values[0][1], values[0][2])
            x = centre_of(cell, lattice, window[0])
            weight = wp.float64(weight_at(x, a, clock[0], lattice[3], low, heads))
            area = wp.length(jumps[n])
            row = wp.vec3d(area * (x_guess[n] - weight), area, zero)
            low_touch = t.vec3()
            high_touch = t.vec3()
            for i in range(27):
                m = n + (i // 9 - 1) * size[1] * size[2] + (i // 3 % 3 - 1) * size[2] + i % 3 - 1
                low_touch = wp.min(low_touch, contact[m])
                high_touch = wp.max(high_touch, contact[m])
            for axis in range(3):
                if low_touch[axis] < real(0.0):
                    wp.atomic_add(rows_out, 2 * axis, row)
                if high_touch[axis] > real(0.0):
                    wp.atomic_add(rows_out, 2 * axis + 1, row)

    return head


@wp.func
def share_of(rim: wp.vec3d, opposite: wp.vec3d):
    """Return the share of a contact at which a film acts; the rows are those of `make_head`.

    A film needs liquid along half of the contact's perimeter, which is taken as that of a square.
    Films on opposite sides act only as far as their areas differ, since they would squeeze a body
    that fills the space between two walls.
    """
    unit = wp.float64(1.0)
    wet = wp.min(rim[1] / (wp.float64(2.0) * wp.sqrt(rim[2])), unit)
    return wet * wp.max(unit - opposite[2] / rim[2], wp.float64(0.0))


@build_once
def make_film(real: Any):
    """Kernel over a region's cells: computes the pressure of a film between a body and walls.

    Where a body lies on a wall, the film is assumed to have the hydrostatic pressure of the liquid
    around the contact; `rims` holds this liquid's sums by direction (`make_head`). In a cell of
    liquid between body and wall, the film has the pressure of the cell. The film acts on the share
    of the contact that `share_of` returns.
    """
    t = types(real)

    @kernel(f"phy124_liquid_film_{real.__name__}", real, seconds=0.3)
    def film(
        solid: int,
        rims: Vectors,
        scale: real,
        low: real,
        heads: t.reals,
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
            side = 2 * axis + int(row > real(0.0))
            rim = rims[side]
            if row != real(0.0) and liquid[n] == 1 and which[n] == solid:
                row -= real(jumps[n][axis])
            if row != real(0.0):
                x = centre_of(cell, lattice, window[0])
                x[axis] = x[axis] - real(0.5) * lattice[3] * wp.sign(row)
                rise = real(rim[0] / wp.max(rim[1], wp.float64(1e-9)))
                q = rise + weight_at(x, a, clock[0], lattice[3], low, heads)
                q = wp.max(q, real(0.0))
                if liquid[n] == 1:
                    q = real(x_guess[n])
                q *= real(share_of(rim, rims[4 * axis + 1 - side]))
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


@build_once
def make_body_gather(real: Any):
    """Kernel: computes the rates at which the pressure changes v and C of a body's particles.

    As in APIC, the changes of momentum and angular momentum equal those of the cells. `most_out` is
    the largest acceleration [m/s^2].
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
    """Kernel: accelerates particles by the pressure of the liquid."""
    t = types(real)

    @kernel(f"phy124_liquid_body_push_{real.__name__}", real, seconds=0.2)
    def body_push(clock, pushes: t.vec3s, turns: t.mat33s, v_out, C_out):
        p = wp.tid()
        v_out[p] = v_out[p] + clock[0] * pushes[p]
        C_out[p] = C_out[p] + clock[0] * turns[p]

    return body_push


def kernels(real: Any) -> list[Any]:
    """Return the kernels of bodies in a liquid."""
    makers = (make_moments, make_contact, make_head, make_film, make_yield, make_answer)
    makers += (make_layers, make_body_change, make_body_gather, make_body_push)
    makers += (shapes.make_body_scatter, shapes.make_body_level, shapes.make_body_volume)
    makers += (shapes.make_body_distance, shapes.make_body_openings, shapes.make_body_push_out)
    return [make(real) for make in makers]
