"""Extrapolates velocities to faces beyond the liquid, for particles near the surface and walls.

Faces that touch no liquid get the mean velocity of their known neighbours, layer by layer. Faces
inside walls then lose the velocity component normal to the wall. Wall friction acts on the first
layer of faces: either Coulomb friction, limited to the coefficient times the pressure, or sticking.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.liquid.faces import cell_of, entry, stride
from phy124.kernels.liquid.walls import centre_of, point, speed_of


@build_once
def make_spread(real: Any):
    """Kernel over cells: sets the velocities at unknown faces to the mean of their known
    neighbours.

    Only unknown faces are written and only known faces are read, so cells may be processed in any
    order.
    """
    t = types(real)

    @kernel(f"phy124_liquid_spread_{real.__name__}", real, seconds=0.3)
    def spread(
        worker: int,
        active: Ints,
        ends: Ints,
        window,
        known: Ints,
        velocity_out: t.vec4s,
        known_out: Ints,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        mask = known[n]
        missing = int(0)
        if mask < 7:
            dx = stride(0, size)
            dy = stride(1, size)
            missing = known[n - 1] | known[n + 1] | known[n - dy] | known[n + dy]
            missing = (missing | known[n - dx] | known[n + dx]) & (7 - mask)
        if missing > 0:
            v = velocity_out[n]
            for axis in range(3):
                bit = 1 << axis
                if missing & bit > 0:
                    total = real(0.0)
                    count = real(0.0)
                    for along in range(3):
                        step = stride(along, size)
                        if known[n - step] & bit > 0:
                            total += velocity_out[n - step][axis]
                            count += real(1.0)
                        if known[n + step] & bit > 0:
                            total += velocity_out[n + step][axis]
                            count += real(1.0)
                    v[axis] = total / count
            velocity_out[n] = v
        known_out[n] = mask | missing

    return spread


@wp.func
def whole(velocity: wp.array(dtype=Any), n: int, axis: int, size: wp.vec3i):
    """Return the velocity at a cell's low face; tangential components are means over four faces."""
    q = velocity[n]
    v = wp.vector(q[0], q[1], q[2])
    back = stride(axis, size)
    for other in range(3):
        if other != axis:
            step = stride(other, size)
            v[other] = type(q[0])(0.25) * (
                q[other]
                + velocity[n + step][other]
                + velocity[n - back][other]
                + velocity[n - back + step][other]
            )
    return v


@wp.func
def normal_at(distances: wp.array(dtype=Any), cell: wp.vec3i, at: wp.vec3i, size: wp.vec3i):
    """Return the direction away from walls at the point `at` [half cells from a cell's corner]."""
    n = wp.vector(
        distances[point(cell, at[0] + 1, at[1], at[2], size)]
        - distances[point(cell, at[0] - 1, at[1], at[2], size)],
        distances[point(cell, at[0], at[1] + 1, at[2], size)]
        - distances[point(cell, at[0], at[1] - 1, at[2], size)],
        distances[point(cell, at[0], at[1], at[2] + 1, size)]
        - distances[point(cell, at[0], at[1], at[2] - 1, size)],
    )
    return wp.normalize(n)


@build_once
def make_slide(real: Any):
    """Kernel over cells: makes velocities inside walls follow the walls; applies friction next to
    walls.

    `frictions` contains two numbers for each wall: the coefficient of friction, and 1 if the wall
    is sticky. The impulse of friction on the liquid is added to `sums_out`; `weight` is the mass
    [kg] of a full cell of liquid with the relative density 1. If `rubs` is 2, the liquid sticks to
    walls by viscosity (`viscous`), and this kernel acts only inside walls.
    """
    t = types(real)

    @kernel(f"phy124_liquid_slide_{real.__name__}", real, seconds=0.5)
    def slide(
        worker: int,
        active: Ints,
        ends: Ints,
        rubs: int,
        weight: real,
        lattice,
        window,
        motions: wp.array2d(dtype=t.vec3),
        frictions: t.vec2s,
        open: t.vec4s,
        shares: t.vec2s,
        distances: t.reals,
        owners: Ints,
        densities: t.vec4s,
        liquid: Ints,
        known: Ints,
        pressure: Doubles,
        velocity: t.vec4s,
        velocity_out: t.vec4s,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        v = velocity[n]
        # The B-spline of a cell far from walls does not reach into a solid.
        if known[n] > 0 and shares[n][1] > real(0.0):
            cell = cell_of(n, size)
            for axis in range(3):
                at = wp.vec3i(1, 1, 1)
                at[axis] = 0
                shut = open[n][axis] == real(0.0)
                near = shut
                if rubs > 0 and not shut:
                    near = distances[point(cell, at[0], at[1], at[2], size)] < lattice[3]
                if near:
                    owner = owners[point(cell, at[0], at[1], at[2], size)]
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
                    dense = densities[n][axis]
                    kept = real(1.0)
                    if rubs > 0:
                        back = n - stride(axis, size)
                        pressed = real(wp.max(pressure[n], pressure[back])) / dense
                        speed = wp.length(along)
                        if speed > real(0.0):
                            kept = wp.max(real(0.0), real(1.0) - rough[0] * pressed / speed)
                        if rough[1] > real(0.0) and (shut or rubs == 1):
                            kept = real(0.0)
                    if shut:
                        v[axis] = u[axis] + kept * along[axis]
                    elif kept < real(1.0):
                        change = (kept - real(1.0)) * along[axis]
                        if liquid[n] + liquid[n - stride(axis, size)] > 0:
                            impulse = wp.float64(weight * dense * open[n][axis] * change)
                            mean = wp.float64(v[axis] + real(0.5) * change)
                            wp.atomic_add(sums_out, owner, axis, impulse)
                            wp.atomic_add(sums_out, owner, 6, impulse * mean)
                        v[axis] = v[axis] + change
        velocity_out[n] = v

    return slide
