"""Impulses of walls on the liquid: the pressure on the solid part of the cells next to them.

The solid surface inside a cell is minus the sum of the open faces (the area of a closed surface is
zero). The pressure there is that of the cell's centre, plus the weight of the liquid between centre
and wall.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.liquid.conjugate import count_of, share
from phy124.kernels.liquid.faces import cell_of, stride
from phy124.kernels.liquid.walls import point
from phy124.kernels.work import IMPULSE, MOVED, TURNED, WORK

vec7d = wp.types.vector(7, wp.float64)
COLUMNS = 7
"""Numbers for each wall: impulse on the liquid, its moment about the origin, and its work."""


@cache
def make_wall_impulses(real: Any):
    """Kernel over parts of the listed cells: adds the impulses of pressure to `sums_out`."""
    t = types(real)

    @kernel(f"phy124_liquid_impulses_{real.__name__}", real, seconds=0.4)
    def wall_impulses(
        part: int,
        density: real,
        counts: Ints,
        listed: Ints,
        lattice,
        window,
        clock,
        values,
        rates,
        slots: Ints,
        open: t.vec4s,
        distances: t.reals,
        owners: Ints,
        pressure: Doubles,
        sums_out: wp.array2d(dtype=wp.float64),
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
            for axis in range(3):
                jump = open[n + stride(axis, size)][axis] - open[n][axis]
                if jump != real(0.0):
                    at = wp.vec3i(1, 1, 1)
                    at[axis] = 0
                    if jump < real(0.0):
                        at[axis] = 2
                    owner = owners[point(cell, at[0], at[1], at[2], size)]
                    if owner >= 0:
                        # The wall lies where the distance, linear towards the face, is zero.
                        d = distances[point(cell, 1, 1, 1, size)]
                        f = distances[point(cell, at[0], at[1], at[2], size)]
                        way = real(0.5) * dx
                        if f < real(0.0) and d > f:
                            way *= wp.clamp(d / (d - f), real(-1.0), real(1.0))
                        way *= -wp.sign(jump)
                        # p dt / (density dx) at the wall.
                        here = real(pressure[n]) + clock[0] * way * a[axis] / dx
                        impulse = here * density * dx * dx * dx * jump
                        x = wp.vector(
                            lattice[0] + dx * (real(low[0] + cell[0]) + real(0.5)),
                            lattice[1] + dx * (real(low[1] + cell[1]) + real(0.5)),
                            lattice[2] + dx * (real(low[2] + cell[2]) + real(0.5)),
                        )
                        x[axis] = x[axis] + way
                        force = t.vec3()
                        force[axis] = impulse
                        turn = wp.cross(x, force)
                        speed = real(0.0)
                        if slots[owner] > 0:
                            speed = rates[slots[owner]][axis]
                        wp.atomic_add(sums_out, owner, axis, wp.float64(impulse))
                        for b in range(3):
                            wp.atomic_add(sums_out, owner, 3 + b, wp.float64(turn[b]))
                        wp.atomic_add(sums_out, owner, 6, wp.float64(impulse * speed))

    return wall_impulses


@kernel("phy124_liquid_settle", seconds=0.2)
def settle(
    walls: int,
    sums_out: wp.array3d(dtype=wp.float64),
    totals_out: wp.array2d(dtype=wp.float64),
    all_out: wp.array2d(dtype=wp.float64),
):
    """Add a step's sums of all workers to the totals of each wall, and to those of all walls.

    A single thread clears the step's sums [workers,walls,7]. Totals hold impulse and moment of each
    wall; `all_out` has one row, in the order of `phy124.kernels.work`.
    """
    for wall in range(walls):
        row = vec7d()
        for worker in range(sums_out.shape[0]):
            for k in range(7):
                row[k] += sums_out[worker, wall, k]
                sums_out[worker, wall, k] = wp.float64(0.0)
        for k in range(6):
            totals_out[wall, k] += row[k]
        for k in range(3):
            all_out[0, IMPULSE + k] += row[k]
        all_out[0, WORK] += row[6]
        all_out[0, MOVED] += wp.sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])
        all_out[0, TURNED] += wp.abs(row[6])
