"""Extrapolates velocities to faces beyond the liquid, for particles near the surface and walls.

The velocity of a face with mass changes by as much as the mean velocity of its known neighbours, so
the face keeps its momentum from step to step. Viscosity reduces the difference from the neighbours.
Faces without mass, and faces inside freely moving bodies, get the mean velocity of their known
neighbours, layer by layer. Faces inside walls lose the velocity component normal to the wall; wall
friction acts on the first layer of faces (docs/design/liquids.md).
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, entry, stride, sums
from phy124.kernels.liquid.walls import centre_of, point, speed_of
from phy124.kernels.native import code


@wp.func
def in_body(
    open: wp.array(dtype=Any),
    owners: wp.array(dtype=int),
    body: int,
    n: int,
    axis: int,
    size: wp.vec3i,
):
    """Return whether a face is inside a freely moving wall; such walls have indices from `body`
    on.
    """
    at = wp.vec3i(1, 1, 1)
    at[axis] = 0
    shut = item(open, n)[axis] == type(item(open, n)[axis])(0.0)
    return shut and item(owners, point(cell_of(n, size), at[0], at[1], at[2], size)) >= body


@wp.func
def around(
    known: wp.array(dtype=int),
    cells: wp.array(dtype=Any),
    velocity: wp.array(dtype=Any),
    n: int,
    row: int,
    layer: int,
):
    """For each low face of a cell, sum over the neighbours that have known velocities.

    Returns one column per face, with the rows: sum of the velocities; number of neighbours;
    momentum that neighbours with mass gained in the step; and the mass of these neighbours. `cells`
    contains the momenta before the step and the masses. If `cells` is empty, the last two rows are
    zero.
    """
    zero = type(velocity[n][0])(0.0)
    total = wp.vector(zero, zero, zero, zero)
    count = wp.vector(zero, zero, zero, zero)
    gain = wp.vector(zero, zero, zero, zero)
    mass = wp.vector(zero, zero, zero, zero)
    for k in range(6):
        step = 1
        if k < 4:
            step = row
        if k < 2:
            step = layer
        m = n + (2 * (k % 2) - 1) * step
        bits = item(known, m)
        v = item(velocity, m)
        for axis in range(3):
            if bits & (1 << axis) > 0:
                total[axis] = total[axis] + v[axis]
                count[axis] = count[axis] + type(zero)(1.0)
                if cells.shape[0] > 0:
                    heavy = item(cells, m)[4 + axis]
                    if heavy > zero:
                        gain[axis] = gain[axis] + (heavy * v[axis] - item(cells, m)[axis])
                        mass[axis] = mass[axis] + heavy
    return wp.matrix_from_rows(total, count, gain, mass)


@wp.func_native(code("spread"))
def around_rows(
    known: wp.array(dtype=int),
    cells: wp.array(dtype=sums(wp.float32)),
    velocity: wp.array(dtype=wp.vec4),
    n: int,
    row: int,
    layer: int,
) -> wp.mat44:
    """Version of `around` with vector instructions of a CPU."""
    ...


FORMS = {"plain": around, "simd": around_rows}
"""Functions that sum over neighbouring faces, by implementation."""


@build_once
def make_spread(real: Any, form: str):
    """Kernel over cells: extrapolates velocities from neighbours to faces without a velocity.

    `cells` contains the sums over the particles. If `cells` is empty, `velocity_out` contains
    displacements, and every unknown face gets the mean of its known neighbours. The walls from the
    index `body` on are freely moving bodies. Only unknown faces are written and only known faces
    are read, so cells may be processed in any order. `viscosity` is eta / (rho dx^2) [1/s] for a
    relative density and viscosity of 1.
    """
    vec8 = sums(real)
    add_up = FORMS[form]

    @kernel(f"phy124_liquid_spread_{real.__name__}_{form}", real, seconds=0.4)
    def spread(
        worker,
        active,
        ends,
        viscosity,
        window,
        clock,
        known,
        densities,
        viscosities,
        cells: wp.array(dtype=vec8),
        open,
        owners,
        body: int,
        velocity_out,
        known_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        mask = item(known, n)
        missing = int(0)
        if mask < 7:
            dx = stride(0, size)
            dy = stride(1, size)
            missing = (
                item(known, n - 1) | item(known, n + 1) | item(known, n - dy) | item(known, n + dy)
            )
            missing = (missing | item(known, n - dx) | item(known, n + dx)) & (7 - mask)
        if missing > 0:
            v = item(velocity_out, n)
            rows = add_up(known, cells, velocity_out, n, stride(1, size), stride(0, size))
            for axis in range(3):
                if missing & (1 << axis) > 0:
                    count = rows[1, axis]
                    mean = rows[0, axis] / count
                    v[axis] = mean
                    mass = real(0.0)
                    if cells.shape[0] > 0:
                        mass = item(cells, n)[4 + axis]
                    if mass > real(0.0) and not in_body(open, owners, body, n, axis, size):
                        moved = rows[3, axis]
                        if moved > real(0.0):
                            k = real(0.0)
                            if viscosity > real(0.0):
                                k = viscosity * clock[0] * item(viscosities, n)[axis] * count
                                k /= item(densities, n)[axis]
                            apart = item(cells, n)[axis] / mass + rows[2, axis] / moved - mean
                            v[axis] = mean + apart / (real(1.0) + k)
            velocity_out[n] = v
        known_out[n] = mask | missing

    return spread


@wp.func
def whole(velocity: wp.array(dtype=Any), n: int, axis: int, size: wp.vec3i):
    """Return the velocity at a cell's low face; tangential components are means of four faces."""
    q = item(velocity, n)
    v = wp.vector(q[0], q[1], q[2])
    back = stride(axis, size)
    for other in range(3):
        if other != axis:
            step = stride(other, size)
            v[other] = type(q[0])(0.25) * (
                q[other]
                + item(velocity, n + step)[other]
                + item(velocity, n - back)[other]
                + item(velocity, n - back + step)[other]
            )
    return v


@wp.func
def normal_at(distances: wp.array(dtype=Any), cell: wp.vec3i, at: wp.vec3i, size: wp.vec3i):
    """Return the direction away from walls at the point `at` [half cells from a cell's corner]."""
    n = wp.vector(
        item(distances, point(cell, at[0] + 1, at[1], at[2], size))
        - item(distances, point(cell, at[0] - 1, at[1], at[2], size)),
        item(distances, point(cell, at[0], at[1] + 1, at[2], size))
        - item(distances, point(cell, at[0], at[1] - 1, at[2], size)),
        item(distances, point(cell, at[0], at[1], at[2] + 1, size))
        - item(distances, point(cell, at[0], at[1], at[2] - 1, size)),
    )
    return wp.normalize(n)


@build_once
def make_slide(real: Any):
    """Kernel over cells: sets velocities inside walls to the walls' velocities; applies friction.

    `frictions` contains two numbers for each wall: the coefficient of friction, and 1 if the wall
    is sticky. The impulse of friction on the liquid is added to `sums_out`; `weight` is the mass
    [kg] of a full cell of liquid with the relative density 1. If `rubs` is 2, the liquid sticks to
    walls by viscosity (`viscous`), and this kernel acts only inside walls.
    """
    t = types(real)

    @kernel(f"phy124_liquid_slide_{real.__name__}", real, seconds=0.5)
    def slide(
        worker,
        active,
        ends,
        rubs: int,
        weight: real,
        lattice,
        window,
        motions,
        frictions,
        open,
        shares,
        distances,
        owners,
        densities,
        liquid,
        known,
        pressure,
        velocity,
        velocity_out,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        v = item(velocity, n)
        # The B-spline of a cell far from walls does not reach into a solid.
        if item(known, n) > 0 and item(shares, n)[1] > real(0.0):
            cell = cell_of(n, size)
            for axis in range(3):
                at = wp.vec3i(1, 1, 1)
                at[axis] = 0
                shut = item(open, n)[axis] == real(0.0)
                near = shut
                if rubs > 0 and not shut:
                    near = item(distances, point(cell, at[0], at[1], at[2], size)) < lattice[3]
                if near:
                    owner = item(owners, point(cell, at[0], at[1], at[2], size))
                    u = t.vec3()
                    rough = t.vec2()
                    if owner >= 0:
                        rough = frictions[owner]
                        x = centre_of(cell, lattice, window[0])
                        x[axis] = x[axis] - real(0.5) * lattice[3]
                        u = speed_of(motions, owner, x)
                    normal = normal_at(distances, cell, at, size)
                    relative = whole(velocity, n, axis, size) - u
                    across = wp.dot(relative, normal)
                    along = relative - across * normal
                    dense = item(densities, n)[axis]
                    kept = real(1.0)
                    if rubs > 0:
                        back = n - stride(axis, size)
                        pressed = real(wp.max(item(pressure, n), item(pressure, back))) / dense
                        speed = wp.length(along)
                        if speed > real(0.0):
                            kept = wp.max(real(0.0), real(1.0) - rough[0] * pressed / speed)
                        if rough[1] > real(0.0) and (shut or rubs == 1):
                            kept = real(0.0)
                    if shut:
                        v[axis] = u[axis] + kept * along[axis]
                    elif kept < real(1.0):
                        change = (kept - real(1.0)) * along[axis]
                        if item(liquid, n) + item(liquid, n - stride(axis, size)) > 0:
                            impulse = wp.float64(weight * dense * item(open, n)[axis] * change)
                            mean = wp.float64(v[axis] + real(0.5) * change)
                            wp.atomic_add(sums_out, owner, axis, impulse)
                            wp.atomic_add(sums_out, owner, 6, impulse * mean)
                        v[axis] = v[axis] + change
        velocity_out[n] = v

    return slide
