"""Couples solids to a liquid: the pressure accelerates both the liquid and the solids.

Let J (V, w) be the flux out of each cell through a solid's surface, and M the solid's mass and
inertia. The pressure equation is (A + rho dx^3 J M^-1 J^T) q = b (Batty, Bertails and Bridson
2007). Each iteration of conjugate gradients sums J^T s and applies the mobility rho dx^3 M^-1
(`conjugate`). A cell is assigned to only one solid.

The weight of the liquid between a cell's centre and the solid's surface is added to the pressure.
Without this weight, the buoyancy would jump when the bottom of the solid passes a layer of cell
centres.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.free.numbers import (
    ANGULAR,
    KICKED,
    MOMENT,
    MOVED,
    PLACE,
    TURNED,
    VELOCITY,
    WORK,
    at3,
    axes,
    inertia_of,
    put3,
    spin_of,
)
from phy124.kernels.liquid.faces import cell_of, entry, stride
from phy124.kernels.liquid.impulses import Sums, head_along, take_row, way_to_wall
from phy124.kernels.liquid.listed import Table, Vectors, count_of, share
from phy124.kernels.liquid.rigid import add_rigid, clear_rigid, rigid_sums, rotation_of
from phy124.kernels.liquid.walls import centre_of, part_of_solid, wall_across


@build_once
def make_motions(real: Any):
    """Kernel over walls with a prescribed motion: computes each wall's mean velocity in a step."""
    t = types(real)

    @kernel(f"phy124_liquid_motions_{real.__name__}", real, seconds=0.15)
    def motions(clock, places: t.vec4s, places_next: t.vec4s, slots, motions_out):
        wall = wp.tid()
        if slots[wall] > 0 and clock[1] > real(0.0):
            r = (places_next[slots[wall]] - places[slots[wall]]) / clock[1]
            motions_out[wall, 0] = wp.vector(r[0], r[1], r[2])

    return motions


@wp.func
def put_motion(motions: wp.array2d(dtype=Any), wall: int, V: wp.vec3d, w: wp.vec3d, X: wp.vec3d):
    """Write the velocity, angular velocity and centre of a solid."""
    like = motions[wall, 0]
    for k in range(3):
        like[k] = type(like[0])(V[k])
    motions[wall, 0] = like
    for k in range(3):
        like[k] = type(like[0])(w[k])
    motions[wall, 1] = like
    for k in range(3):
        like[k] = type(like[0])(X[k])
    motions[wall, 2] = like


@wp.func
def lever(R: wp.mat33d, levers: wp.vec3d, w: wp.vec3d):
    """Return a vector without its components along axes of symmetry."""
    return R @ wp.cw_mul(levers, wp.transpose(R) @ w)


@build_once
def make_jumps(real: Any):
    """Kernel over cells: computes the rows of J, for the velocity and angular velocity of a solid.

    `wall` is the index of the first wall that is a solid; all later walls are solids as well. If
    both a freely moving solid and another wall cut a cell, only the surface of the solid counts.
    """

    @kernel(f"phy124_liquid_jumps_{real.__name__}", real, seconds=0.2)
    def jumps(
        worker,
        active,
        ends,
        wall,
        lattice,
        window,
        open,
        covers,
        distances,
        owners,
        liquid,
        centres,
        which_out,
        jumps_out,
        turns_out: Vectors,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        row = wp.vec3d()
        solids = wp.vec3i(-1, -1, -1)
        solid = int(-1)
        most = real(0.0)
        cell = cell_of(n, size)
        if liquid[n] == 1:
            for axis in range(3):
                jump = open[n + stride(axis, size)][axis] - open[n][axis]
                part = part_of_solid(jump, covers, n, stride(axis, size), axis)
                rest = jump - part
                if part != real(0.0):
                    solids[axis] = 0
                if rest != real(0.0):
                    owner = wall_across(cell, axis, rest, size, distances, owners, lattice[3])
                    owner -= wall
                    if owner == 0:
                        part = jump
                        solids[axis] = 0
                    elif owner > 0 and wp.abs(rest) > wp.abs(part):
                        part = rest
                        solids[axis] = owner
                row[axis] = -wp.float64(part)
                if wp.abs(part) > most:
                    most = wp.abs(part)
                    solid = solids[axis]
        for axis in range(3):
            if solids[axis] != solid:
                row[axis] = wp.float64(0.0)
        which_out[n] = solid
        jumps_out[n] = row
        if solid >= 0:
            arm = wide(centre_of(cell, lattice, window[0])) - centres[solid]
            turns_out[n] = wp.cross(arm, row)

    return jumps


@build_once
def make_lift(real: Any):
    """Kernel over parts of the cells: sums the liquid's weight between cell centres and solids.

    The sums are the impulse on each solid and its moment about the solid's centre, both divided by
    rho dx^3.
    """

    @kernel(f"phy124_liquid_lift_{real.__name__}", real, seconds=0.3)
    def lift(
        part,
        counts,
        listed,
        lattice,
        window,
        clock,
        values,
        densities,
        distances,
        which,
        jumps,
        centres,
        gains,
        sums_out: Table,
    ):
        p = part + wp.tid()
        size = window[1]
        dx = lattice[3]
        a = wp.vector(values[0][0], values[0][1], values[0][2])
        span = share(count_of(counts), p, counts.shape[0])
        clear_rigid(sums_out, centres.shape[0], p)
        for k in range(span[0], span[1]):
            n = listed[k]
            if which[n] >= 0:
                j = jumps[n]
                cell = cell_of(n, size)
                f = wp.vec3d()
                for axis in range(3):
                    if j[axis] != wp.float64(0.0):
                        way = way_to_wall(cell, axis, -real(j[axis]), size, distances, dx)
                        head = head_along(way, axis, clock[0], a, gains, n, densities, dx)
                        f[axis] = j[axis] * wp.float64(head)
                arm = wide(centre_of(cell, lattice, window[0])) - centres[which[n]]
                add_rigid(sums_out, which[n], p, f, wp.cross(arm, f))

    return lift


@build_once
def make_kick(real: Any):
    """Single-thread kernel: applies gravity to a solid; writes its motion, mobility and centre.

    `scale` is rho dx^3 [kg]. The mobility consists of scale / M and of the matrix scale I^-1 for
    the inertia I. If a component of `levers` is 0 (`FreeBody.levers`), the liquid does not rotate
    the solid about this axis, and such a rotation does not move the liquid.
    """

    @kernel(f"phy124_liquid_kick_{real.__name__}", real, seconds=0.3)
    def kick(
        solid,
        mass: wp.float64,
        scale: wp.float64,
        moments,
        levers: wp.vec3d,
        clock,
        values,
        plans_out: wp.array2d(dtype=wp.vec3d),
        mobility_out: Table,
        centres_out,
        body_out,
    ):
        dt = wp.float64(clock[0])
        # Before the first step, particles are moved apart without a kick.
        if body_out[KICKED] == wp.float64(0.0) and dt > wp.float64(0.0):
            pull = dt * wide(values[0])
            put3(body_out, VELOCITY, at3(body_out, VELOCITY) + pull)
            body_out[KICKED] = wp.float64(1.0)
        plans_out[solid, 0] = at3(body_out, VELOCITY)
        R = axes(body_out)
        plans_out[solid, 1] = lever(R, levers, spin_of(R, moments, at3(body_out, ANGULAR)))
        centres_out[solid] = at3(body_out, PLACE)
        inverse = inertia_of(R, wp.cw_div(levers, moments))
        mobility_out[solid, 0] = scale / mass
        for a in range(3):
            for b in range(3):
                mobility_out[solid, 1 + 3 * a + b] = scale * inverse[a, b]

    return kick


@build_once
def make_push(real: Any):
    """Single-thread kernel: accelerates a freely moving solid by the pressure of the liquid."""

    @kernel(f"phy124_liquid_push_{real.__name__}", real, seconds=0.2)
    def push(clock, rates: Vectors, body_out):
        dt = wp.float64(clock[0])
        put3(body_out, VELOCITY, at3(body_out, VELOCITY) + dt * rates[0])
        put3(body_out, ANGULAR, at3(body_out, ANGULAR) + dt * rates[1])

    return push


@build_once
def make_predict(real: Any):
    """Kernel over solids: writes each solid's motion before the pressure equation is solved.

    This is the motion due to gravity, plus the response to the sums of `make_lift`.
    """

    @kernel(f"phy124_liquid_predict_{real.__name__}", real, seconds=0.3)
    def predict(
        wall, plans: wp.array2d(dtype=wp.vec3d), centres, mobility: Table, sums: Table, motions_out
    ):
        solid = wp.tid()
        force, turn = rigid_sums(sums, solid)
        V = plans[solid, 0] + mobility[solid, 0] * force
        w = plans[solid, 1] + rotation_of(mobility, solid, turn)
        put_motion(motions_out, wall + solid, V, w, centres[solid])

    return predict


@build_once
def make_respond(real: Any):
    """Single-thread kernel: applies to a solid the opposite of its impulses on the liquid.

    `total_out` accumulates the impulses on the liquid, as in phy124/kernels/free. The work of an
    impulse is the impulse times the mean of the solid's velocities at the start of the step and
    after the impulse. If `pulled` is 1, the present velocity already includes the step's gravity.
    """

    @kernel(f"phy124_liquid_respond_{real.__name__}", real, seconds=0.3)
    def respond(
        mass: wp.float64,
        moments,
        levers: wp.vec3d,
        wall,
        pulled: int,
        clock,
        values,
        sums_out: Sums,
        motions_out,
        total_out: Doubles,
        body_out,
    ):
        row = take_row(sums_out, wall)
        J = wp.vec3d(row[0], row[1], row[2])
        arm = at3(body_out, PLACE)
        moment = wp.vec3d(row[3], row[4], row[5])
        R = axes(body_out)
        about = lever(R, levers, moment - wp.cross(arm, J))
        V = at3(body_out, VELOCITY) - wp.float64(pulled) * wp.float64(clock[0]) * wide(values[0])
        spin = spin_of(R, moments, at3(body_out, ANGULAR))
        put3(body_out, VELOCITY, at3(body_out, VELOCITY) - J / mass)
        put3(body_out, ANGULAR, at3(body_out, ANGULAR) - about)
        for k in range(3):
            total_out[k] += J[k]
            total_out[MOMENT + k] += wp.cross(arm, J)[k] + about[k]
        w = spin_of(R, moments, at3(body_out, ANGULAR))
        both = wp.dot(J, V + at3(body_out, VELOCITY)) + wp.dot(about, spin + w)
        total_out[WORK] += wp.float64(0.5) * both
        total_out[MOVED] += wp.length(J)
        total_out[TURNED] += wp.float64(0.5) * wp.abs(both)
        put_motion(motions_out, wall, at3(body_out, VELOCITY), lever(R, levers, w), arm)

    return respond
