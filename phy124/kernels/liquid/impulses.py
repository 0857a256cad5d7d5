"""Sums the impulses of walls on the liquid, from the pressure in the cells next to the walls.

The area vector of the solid surface inside a cell is minus the sum of the open faces' area vectors.
The pressure on this surface is the pressure at the cell's centre, plus the weight of the liquid
between the centre and the wall. Other forces on particles are treated like weight.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.liquid.faces import cell_at, cell_of, inner, local, number, stride
from phy124.kernels.liquid.listed import count_of, share
from phy124.kernels.liquid.mixture import CENTRE
from phy124.kernels.liquid.pressure import NEAREST
from phy124.kernels.liquid.transfer import within
from phy124.kernels.liquid.walls import (
    centre_of,
    halves,
    part_of_solid,
    point,
    solid_face,
    speed_of,
    wall_across,
)
from phy124.kernels.work import IMPULSE, MOVED, TURNED, WORK

Sums = wp.array3d(dtype=wp.float64)
vec7d = wp.types.vector(7, wp.float64)
COLUMNS = 7
"""Number of sums for each wall: impulse on the liquid [3], moment [3], and work."""


@wp.func
def way_to_wall(
    cell: wp.vec3i, axis: int, jump: Any, size: wp.vec3i, distances: wp.array(dtype=Any), dx: Any
):
    """Return the distance along an axis from a cell's centre to the wall in the cell [m].

    At an edge of a solid, the distance is computed along nine parallel lines. The result is taken
    from the line that ends deepest in the solid.
    """
    d = distances[point(cell, 1, 1, 1, size)]
    f = distances[solid_face(cell, axis, jump, size)]
    if f >= type(dx)(0.0):
        points = halves(size)
        to_face = solid_face(cell, axis, jump, size) - point(cell, 1, 1, 1, size)
        a = stride((axis + 1) % 3, points)
        b = stride((axis + 2) % 3, points)
        for u in range(-1, 2):
            for v in range(-1, 2):
                at = point(cell, 1, 1, 1, size) + u * a + v * b
                if distances[at + to_face] < f:
                    f = distances[at + to_face]
                    d = distances[at]
    way = type(dx)(0.5) * dx
    if f < type(dx)(0.0) and d > f:
        way *= wp.clamp(d / (d - f), type(dx)(-1.0), type(dx)(1.0))
    return -wp.sign(jump) * way


@wp.func
def take_row(sums: Sums, wall: int):
    """Return the total of all workers' sums for a wall, and reset the sums to zero."""
    row = vec7d()
    for worker in range(sums.shape[0]):
        for k in range(7):
            row[k] += sums[worker, wall, k]
            sums[worker, wall, k] = wp.float64(0.0)
    return row


@wp.func
def gain_in(gains: wp.array(dtype=Any), n: int, count: int):
    """Return the mean velocity change by forces around a cell; `count` is the number of cells."""
    total = gains[n]
    for k in range(n + count, gains.shape[0], count):
        total += gains[k]
    gain = wp.vector(total[0], total[1], total[2])
    if total[3] > type(total[3])(0.0):
        gain /= total[3]
    return gain


@wp.func
def head_along(
    way: Any,
    axis: int,
    kick: Any,
    a: Any,
    gains: wp.array(dtype=Any),
    n: int,
    dense: wp.array(dtype=Any),
    dx: Any,
):
    """Return the change of the pressure solution q from a cell's centre to a point in the cell.

    The point is at the distance `way` [m] along an axis.
    """
    change = kick * way * a[axis] / dx * dense[n][CENTRE]
    if gains.shape[0] > 0:
        gain = gain_in(gains, n, dense.shape[0])
        change += way * gain[axis] / dx * dense[n][CENTRE]
    return change


@build_once
def make_gains(real: Any):
    """Kernel: adds each particle's mass, and its momentum gained since `v_kept`, to eight cells."""
    t = types(real)

    @kernel(f"phy124_liquid_gains_{real.__name__}", real, seconds=0.3)
    def liquid_gains(mass, lattice, window, x, v, v_kept: t.vec3s, gains_out):
        p = wp.tid()
        half = real(0.5)
        s = local(x[p], lattice, window) - wp.vector(half, half, half)
        size = window[1]
        low = cell_at(s)
        if inner(low, size, 1):
            high = within(s, low)
            gain = v[p] - v_kept[p]
            for k in range(8):
                step = wp.vec3i(k // 4, (k // 2) % 2, k % 2)
                w = mass[p]
                for c in range(3):
                    if step[c] == 1:
                        w *= high[c]
                    else:
                        w *= real(1.0) - high[c]
                total = wp.vector(w * gain[0], w * gain[1], w * gain[2], w)
                wp.atomic_add(gains_out, number(low + step, size), total)

    return liquid_gains


@build_once
def make_wall_impulses(real: Any):
    """Kernel over parts of the cells: adds the impulses of the pressure on walls to `sums_out`.

    The walls from the index `solid` on are solids, and those from `bodies` on are bodies.
    `pressed_out` receives the impulses on bodies.
    """
    t = types(real)

    @kernel(f"phy124_liquid_impulses_{real.__name__}", real, seconds=0.4)
    def wall_impulses(
        part,
        density: real,
        counts,
        listed,
        lattice,
        window,
        clock,
        values,
        motions,
        open,
        covers,
        distances,
        owners,
        densities,
        phi,
        pressure,
        gains,
        solid,
        bodies: int,
        sums_out: wp.array2d(dtype=wp.float64),
        pressed_out: t.vec3s,
    ):
        p = part + wp.tid()
        size = window[1]
        low = window[0]
        dx = lattice[3]
        span = share(count_of(counts), p, counts.shape[0])
        q = values[0]
        a = wp.vector(q[0], q[1], q[2])
        for k in range(span[0], span[1]):
            n = listed[k]
            cell = cell_of(n, size)
            pressed = t.vec3()
            # The loop count is not a constant, so that the compiler does not unroll the loop.
            count = int(6)
            for i in range(count):
                axis = i // 2
                jump = open[n + stride(axis, size)][axis] - open[n][axis]
                closing = part_of_solid(jump, covers, n, stride(axis, size), axis)
                owner = solid
                if i % 2 == 1:
                    closing = jump - closing
                if closing != real(0.0):
                    if i % 2 == 1:
                        owner = wall_across(cell, axis, closing, size, distances, owners, dx)
                    if owner >= 0:
                        way = way_to_wall(cell, axis, closing, size, distances, dx)
                        # `here` is p dt / (density dx) at the wall.
                        here = real(pressure[n])
                        here += head_along(way, axis, clock[0], a, gains, n, densities, dx)
                        if phi[n] > real(0.0):
                            # The surface of a thin layer is between the wall and the centre.
                            centre = wp.abs(way) / dx
                            here *= wp.max(centre - phi[n], real(0.0)) / (centre + real(NEAREST))
                        impulse = here * density * dx * dx * dx * closing
                        x = centre_of(cell, lattice, low)
                        speed = speed_of(motions, owner, x)[axis]
                        x[axis] = x[axis] + way
                        force = t.vec3()
                        force[axis] = impulse
                        turn = wp.cross(x, force)
                        wp.atomic_add(sums_out, owner, axis, wp.float64(impulse))
                        for b in range(3):
                            wp.atomic_add(sums_out, owner, 3 + b, wp.float64(turn[b]))
                        wp.atomic_add(sums_out, owner, 6, wp.float64(impulse * speed))
                        if owner >= bodies:
                            pressed[axis] = -impulse
            if pressed_out.shape[0] > 0:
                pressed_out[n] = pressed

    return wall_impulses


@kernel("phy124_liquid_settle", seconds=0.2)
def settle(
    walls: int,
    sums_out: Sums,
    totals_out: wp.array2d(dtype=wp.float64),
    all_out: wp.array2d(dtype=wp.float64),
):
    """Add the workers' sums of a step to the totals of each wall and to the totals over all walls.

    A single thread then clears the step's sums [workers,walls,7]. The totals contain the impulse
    and moment of each wall. `all_out` is one row of sums in the order of `phy124.kernels.work`.
    """
    for wall in range(walls):
        row = take_row(sums_out, wall)
        for k in range(6):
            totals_out[wall, k] += row[k]
        for k in range(3):
            all_out[0, IMPULSE + k] += row[k]
        all_out[0, WORK] += row[6]
        all_out[0, MOVED] += wp.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])
        all_out[0, TURNED] += wp.abs(row[6])
