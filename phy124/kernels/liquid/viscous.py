"""Viscosity of a liquid: weights of the strain rates, walls, and the effect on the pressure.

The new velocities u minimise the sum of m |u - u0|^2 / 2 over the faces plus the sum of dt eta V
|D|^2 over the samples of the strain rate D (Batty and Bridson 2008). Here u0 are the old velocities
and m the masses of the faces. Normal strain rates are sampled at the centres of cells, shear rates
at their edges. V is the liquid volume around a sample. At the minimum, there is no traction at the
liquid's surface. Masses are in units of rho dx^3, so the factor of V becomes k = dt eta / (rho
dx^2).

Faces behind a sticky wall have the wall's velocity. A strain rate between such a face and the
liquid is computed with the distance from the wall. A wall without friction exerts no shear stress.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, entry, inner, stride, sums
from phy124.kernels.liquid.listed import Vectors
from phy124.kernels.liquid.mixture import CENTRE
from phy124.kernels.liquid.pressure import beyond, outflow
from phy124.kernels.liquid.spread import normal_at
from phy124.kernels.liquid.stress import reaction
from phy124.kernels.liquid.walls import centre_of, point, speed_of

FREE, HELD, STICKY = wp.constant(1), wp.constant(8), wp.constant(64)
"""Bits of a cell's state, times 2^axis: the velocity of the low face is an unknown; the face has
the velocity of a wall; this wall is sticky.
"""
CLOSEST = wp.constant(0.1)
"""Lower bound of a face's distance from a wall [cells]; a closer wall would take all momentum."""
ALIGNED = wp.constant(0.999)
"""A wall without friction holds a face if the cosine between their normals is above this value.
On oblique walls, the liquid could not slide if the walls held faces.
"""
FEEDBACK = wp.constant(0.67)
"""Pressure per bulk rate of strain that the viscous step leaves, in units of the viscosity. Stable
from 0 to 4/3: a free liquid resists uniform compression with 2/3, and short waves with 2.
"""


@wp.func
def foot_of(cell: wp.vec3i, axis: int, lattice: Any, low: wp.vec3i, apart: Any, normal: Any):
    """Return the point of a wall that is nearest to the middle of a cell's low face, `apart` [m]
    away.
    """
    x = centre_of(cell, lattice, low)
    x[axis] = x[axis] - type(apart)(0.5) * lattice[3]
    return x - apart * normal


@wp.func
def face_point(cell: wp.vec3i, axis: int, size: wp.vec3i):
    """Return the index of the point in the middle of a cell's low face."""
    at = wp.vec3i(1, 1, 1)
    at[axis] = 0
    return point(cell, at[0], at[1], at[2], size)


@build_once
def make_hold(real: Any):
    """Kernel over cells: finds the faces with unknown velocities and the faces that move with a
    wall.

    `known` contains a bit for each face with mass. Walls from the index `solid` on move freely, and
    prescribe no velocities of faces. All arrays of the solution are reset.
    """

    @kernel(f"phy124_liquid_hold_{real.__name__}", real, seconds=0.4)
    def hold(
        worker,
        active,
        ends,
        solid,
        lattice,
        window,
        known,
        open,
        distances,
        owners,
        frictions,
        motions,
        velocity,
        states_out,
        u_out: Vectors,
        z_out: Vectors,
        first_out: Vectors,
        second_out: Vectors,
        normal_out: Vectors,
        shear_out: Vectors,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        cell = cell_of(n, size)
        state = int(0)
        u = wp.vec3d()
        if inner(cell, size, 1):
            for axis in range(3):
                face = face_point(cell, axis, size)
                apart = item(distances, face)
                wall = item(owners, face)
                held = int(0)
                if apart < lattice[3] and wall >= 0 and wall < solid:
                    sticky = frictions[wall][1] > real(0.0)
                    at = wp.vec3i(1, 1, 1)
                    at[axis] = 0
                    normal = normal_at(distances, cell, at, size)
                    if item(open, n)[axis] == real(0.0) or (sticky and apart < real(0.0)):
                        if sticky:
                            held = HELD + STICKY
                        elif wp.abs(normal[axis]) > real(ALIGNED):
                            held = HELD
                    if held > 0:
                        x = foot_of(cell, axis, lattice, window[0], apart, normal)
                        u[axis] = wp.float64(speed_of(motions, wall, x)[axis])
                if held == 0 and item(known, n) & (1 << axis) > 0:
                    held = FREE
                    u[axis] = wp.float64(item(velocity, n)[axis])
                state += held << axis
        states_out[n] = state
        u_out[n] = u
        z_out[n] = wp.vec3d()
        first_out[n] = wp.vec3d()
        second_out[n] = wp.vec3d()
        normal_out[n] = wp.vec3d()
        shear_out[n] = wp.vec3d()

    return hold


@wp.func
def inverse_span(
    states: wp.array(dtype=int),
    distances: wp.array(dtype=Any),
    n: int,
    m: int,
    axis: int,
    shear: int,
    size: wp.vec3i,
):
    """Return the factor that converts a velocity difference of two faces to a strain rate
    [1/cells].

    The factor is 0 if a face has no velocity, and above 1 if a wall is between the faces. For a
    shear rate (`shear`), the factor is 0 at a wall without friction.
    """
    zero = type(item(distances, 0))(0.0)
    unit = type(zero)(1.0)
    a = item(states, n) >> axis
    b = item(states, m) >> axis
    if shear > 0:
        if a & HELD > 0 and a & STICKY == 0:
            return zero
        if b & HELD > 0 and b & STICKY == 0:
            return zero
    if a & FREE > 0 and b & FREE > 0:
        return unit
    if a & HELD > 0 and b & HELD > 0:
        return unit
    if (a | b) & FREE == 0 or (a | b) & HELD == 0:
        return zero
    inside = item(distances, face_point(cell_of(n, size), axis, size))
    outside = item(distances, face_point(cell_of(m, size), axis, size))
    if a & FREE > 0:
        before = inside
        inside = outside
        outside = before
    part = outside / wp.max(outside - inside, type(zero)(1e-30))
    return unit / wp.clamp(part, type(zero)(CLOSEST), unit)


@wp.func
def vacant_part(
    eighths: wp.array(dtype=Any),
    shares: wp.array(dtype=Any),
    n: int,
    low: wp.vec3i,
    high: wp.vec3i,
    size: wp.vec3i,
):
    """Return the sum of the open fractions of a cell's octants `low` to `high`, divided by 8."""
    total = type(item(eighths, 0))(0.0)
    if item(shares, n)[1] == total:  # no wall is near
        count = (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1)
        return type(total)(0.125) * type(total)(count)
    cell = cell_of(n, size)
    for a in range(low[0], high[0] + 1):
        for b in range(low[1], high[1] + 1):
            for c in range(low[2], high[2] + 1):
                row = (2 * cell[0] + a) * 2 * size[1] + 2 * cell[1] + b
                total += item(eighths, row * 2 * size[2] + 2 * cell[2] + c)
    return type(total)(0.125) * total


@wp.func
def below(phi: Any):
    """Return the fraction of a cell that is below a flat surface at the height -phi."""
    return wp.clamp(type(phi)(0.5) - phi, type(phi)(0.0), type(phi)(1.0))


@wp.func
def filled_face(phi: wp.array(dtype=Any), liquid: wp.array(dtype=int), n: int, m: int):
    """Return the filled fraction of the volume between the centres of two cells.

    At the surface, the fraction equals the distance [cells] over which the pressure falls to zero
    (pressure.py).
    """
    wet = item(liquid, n) + item(liquid, m)
    if wet == 1 and item(liquid, n) == 1:
        return wp.min(beyond(item(phi, n), item(phi, m)), type(item(phi, n))(1.0))
    if wet == 1:
        return wp.min(beyond(item(phi, m), item(phi, n)), type(item(phi, n))(1.0))
    return below(type(item(phi, n))(0.5) * (item(phi, n) + item(phi, m)))


@build_once
def make_weigh(real: Any):
    """Kernel over cells: computes the weights of the faces and of the strain rates of each cell.

    A cell has three normal strain rates, and the shear rates at the three edges at its lowest
    corner. At an edge, the strain is `first` a + `second` b, where a and b are the velocity
    differences of two pairs of faces. `wet_out` is 1 for cells whose weights are not zero.
    `viscosity` is eta / (rho dx^2) [1/s] for a relative density and viscosity of 1.
    """
    t = types(real)

    @kernel(f"phy124_liquid_weigh_{real.__name__}", real, seconds=0.6)
    def weigh(
        worker,
        active,
        ends,
        viscosity,
        window,
        clock,
        densities,
        viscosities,
        open,
        shares,
        eighths: t.reals,
        distances,
        phi,
        liquid,
        states,
        mass_out: t.vec3s,
        stretch_out: t.vec3s,
        first_out: t.vec3s,
        second_out: t.vec3s,
        wet_out: Ints,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        near = item(states, n)
        inside = inner(cell_of(n, size), size, 2)
        if inside:
            for axis in range(3):
                step = stride(axis, size)
                near = near | item(states, n + step) | item(states, n - step)
        wet = wp.where(inside and near & (7 * FREE) > 0, 1, 0)
        mass = t.vec3()
        stretch = t.vec3()
        first = t.vec3()
        second = t.vec3()
        if wet == 1:
            k = viscosity * clock[0]
            none = wp.vec3i(0, 0, 0)
            all = wp.vec3i(1, 1, 1)
            volume = below(item(phi, n))
            if volume > real(0.0):
                volume *= vacant_part(eighths, shares, n, none, all, size)
            for axis in range(3):
                step = stride(axis, size)
                if volume > real(0.0):
                    inverse = inverse_span(states, distances, n, n + step, axis, 0, size)
                    eta = item(viscosities, n)[CENTRE]
                    stretch[axis] = real(2.0) * k * eta * volume * inverse * inverse
                filled = filled_face(phi, liquid, n, n - step)
                if (item(states, n) >> axis) & FREE > 0 and filled > real(0.0):
                    # The pressure equation has the same masses of faces cut by walls.
                    mass[axis] = item(densities, n)[axis] * filled * item(open, n)[axis]
                a = (axis + 1) % 3
                b = (axis + 2) % 3
                along = stride(a, size)
                across = stride(b, size)
                level = item(phi, n) + item(phi, n - along)
                level += item(phi, n - across) + item(phi, n - along - across)
                p = real(0.0)
                q = real(0.0)
                if level < real(4.0):  # below 1 on average
                    p = inverse_span(states, distances, n, n - across, a, 1, size)
                    q = inverse_span(states, distances, n, n - along, b, 1, size)
                if p > real(0.0) and q > real(0.0):
                    total = real(0.0)
                    level = real(0.0)
                    wetted = real(1e-9)
                    fluidity = real(0.0)
                    for u in range(2):
                        for v in range(2):
                            m = n - u * along - v * across
                            low = none
                            high = all
                            low[a] = u
                            high[a] = u
                            low[b] = v
                            high[b] = v
                            part = vacant_part(eighths, shares, m, low, high, size)
                            total += part
                            level += part * item(phi, m)
                            # Between liquids, the harmonic mean has the right shear stress.
                            part *= below(item(phi, m))
                            wetted += part
                            fluidity += part / wp.max(item(viscosities, m)[CENTRE], real(1e-12))
                    if total > real(0.0) and fluidity > real(0.0):
                        weight = k * total * below(level / total) * wetted / fluidity
                        first[axis] = wp.sqrt(weight) * p
                        second[axis] = wp.sqrt(weight) * q
        mass_out[n] = mass
        stretch_out[n] = stretch
        first_out[n] = first
        second_out[n] = second
        wet_out[n] = wet

    return weigh


@build_once
def make_resist(real: Any):
    """Kernel over cells: copies the new velocities, and sums the impulses of walls on the liquid.

    `scale` is rho dx^3 [kg].
    """
    t = types(real)
    vec8 = sums(real)

    @kernel(f"phy124_liquid_resist_{real.__name__}", real, seconds=0.4)
    def resist(
        worker,
        active,
        ends,
        scale: wp.float64,
        lattice,
        window,
        known,
        distances,
        owners,
        states,
        cells: wp.array(dtype=vec8),
        first: t.vec3s,
        second: t.vec3s,
        normal: Vectors,
        shear: Vectors,
        u: Vectors,
        velocity_out,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0 or item(states, n) == 0:
            return
        size = window[1]
        v = velocity_out[n]
        here = item(u, n)
        if (item(states, n) // HELD) & 7 > 0 and inner(cell_of(n, size), size, 2):
            force = scale * reaction(n, size, first, second, normal, shear)
            cell = cell_of(n, size)
            for axis in range(3):
                if (item(states, n) >> axis) & HELD > 0:
                    impulse = wp.vec3d()
                    impulse[axis] = force[axis]
                    if item(known, n) & (1 << axis) > 0:
                        change = here[axis] - wp.float64(v[axis])
                        impulse[axis] += wp.float64(item(cells, n)[4 + axis]) * change
                    if impulse[axis] != wp.float64(0.0):
                        face = face_point(cell, axis, size)
                        at = wp.vec3i(1, 1, 1)
                        at[axis] = 0
                        away = normal_at(distances, cell, at, size)
                        apart = item(distances, face)
                        x = foot_of(cell, axis, lattice, window[0], apart, away)
                        turn = wp.cross(wide(x), impulse)
                        owner = item(owners, face)
                        wp.atomic_add(sums_out, owner, axis, impulse[axis])
                        for b in range(3):
                            wp.atomic_add(sums_out, owner, 3 + b, turn[b])
                        wp.atomic_add(sums_out, owner, 6, impulse[axis] * here[axis])
        for axis in range(3):
            if ((item(states, n) >> axis) & FREE) + (item(known, n) & (1 << axis)) > 0:
                v[axis] = real(here[axis])
        velocity_out[n] = v

    return resist


@wp.func
def loose_wall(open: wp.array(dtype=Any), states: wp.array(dtype=int), n: int, size: wp.vec3i):
    """Return whether a wall in a cell prescribes the velocity of none of the cell's faces."""
    result = bool(False)
    for axis in range(3):
        m = n + stride(axis, size)
        if item(open, n)[axis] != item(open, m)[axis]:
            both = item(states, n) | item(states, m)
            result = result or (both >> axis) & HELD == 0
    return result


@build_once
def make_bulk(real: Any):
    """Kernel over cells: computes a pressure from the divergence left by the viscous step.

    The result is 0 in a cell whose wall prescribes no velocities of faces, since this wall limits
    the flow only in the pressure solution.
    """

    @kernel(f"phy124_liquid_bulk_{real.__name__}", real, seconds=0.3)
    def bulk(
        worker,
        active,
        ends,
        viscosity,
        moving: int,
        solid,
        lattice,
        window,
        clock,
        viscosities,
        motions,
        open,
        covers,
        distances,
        owners,
        liquid,
        states,
        velocity,
        excess_out: Doubles,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        excess = wp.float64(0.0)
        if item(liquid, n) == 1 and not loose_wall(open, states, n, window[1]):
            flux = outflow(
                n, moving, solid, lattice, window, motions, open, covers, distances, owners,
                velocity,
            )  # fmt: skip
            k = real(FEEDBACK) * viscosity * clock[0] * item(viscosities, n)[CENTRE]
            excess = wp.float64(k * flux)
        excess_out[n] = excess

    return bulk


@build_once
def make_release(real: Any):
    """Kernel over cells: subtracts the pressure of `make_bulk` from the pressure, then resets
    it.
    """

    @kernel(f"phy124_liquid_release_{real.__name__}", real)
    def release(worker, active, ends, pressure_out, excess_out: Doubles):
        n = entry(active, ends, worker, wp.tid())
        if n >= 0:
            pressure_out[n] = pressure_out[n] - excess_out[n]
            excess_out[n] = wp.float64(0.0)

    return release
