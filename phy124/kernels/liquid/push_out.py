"""Moves particles of liquid out of walls."""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.distance import SHAPES
from phy124.kernels.liquid.faces import cell_at, inner, local
from phy124.kernels.liquid.walls import GAP, point, speed_of, to_frame, to_world

NEAR = wp.constant(1.5)
"""Largest distance [cells] from which a particle can get behind a wall in a step."""


@build_once
def make_push_out(shape: str, real: Any):
    """Kernel: moves particles out of all walls of a shape and stops them there.

    `walls` contains the indices of the shape's walls in `slots` and `frictions`; `geometries`
    contains their dimensions. A wall stops the normal velocity, and reduces the tangential velocity
    by up to the coefficient of friction times the normal velocity. A sticky wall also stops the
    tangential velocity.

    The impulse on the particles and its work are added to `sums_out`. The work on a single drop (C
    = 0) is computed with its mean velocity in the step, so a floor does no work on drops that lie
    on it.
    """
    t = types(real)
    distance = SHAPES[shape]

    @wp.func
    def stop(v: t.vec3, u: t.vec3, normal: t.vec3, rough: t.vec2):
        """Return a particle's velocity after contact with a wall of velocity u.

        `rough` contains the coefficient of friction, and 1 if the liquid sticks to the wall.
        """
        along = wp.dot(v - u, normal)
        if along >= real(0.0):
            return v
        slide = v - u - along * normal
        speed = wp.length(slide)
        kept = real(0.0)
        if speed > real(0.0) and rough[1] == real(0.0):
            kept = wp.max(real(0.0), real(1.0) + rough[0] * along / speed)
        return u + kept * slide

    @kernel(f"phy124_liquid_push_out_{shape}_{real.__name__}", real, seconds=0.4)
    def push_out(
        stops: int,
        walls: Ints,
        geometries,
        slots,
        frictions,
        mass,
        lattice,
        window,
        values,
        clock,
        tracks: wp.array(dtype=t.vec4),
        C,
        motions,
        frame,
        distances,
        x_out,
        v_out,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        p = wp.tid()
        dx = lattice[3]
        x = x_out[p]
        size = window[1]
        cell = cell_at(local(x, lattice, window))
        d = real(-1.0)
        if inner(cell, size, 0):
            d = distances[point(cell, 1, 1, 1, size)]
        if d < real(NEAR) * dx:
            for k in range(walls.shape[0]):
                wall = walls[k]
                place, active = to_frame(x, slots[wall], values, frame)
                s = distance(place, geometries[k])
                if active > real(0.0) and s[3] < real(GAP) * dx:
                    normal = to_world(wp.vector(s[0], s[1], s[2]), frame)
                    x += (real(GAP) * dx - s[3]) * normal
                    x_out[p] = x
                    if stops > 0:
                        u = speed_of(motions, wall, x)
                        before = v_out[p]
                        after = stop(before, u, normal, frictions[wall])
                        v_out[p] = after
                        start = before
                        if C[p] == t.mat33():
                            a = tracks[0]
                            start -= clock[0] * wp.vector(a[0], a[1], a[2])
                        change = mass[p] * (after - before)
                        work = real(0.5) * wp.dot(change, after + start)
                        turn = wp.cross(x, change)
                        for axis in range(3):
                            wp.atomic_add(sums_out, wall, axis, wp.float64(change[axis]))
                            wp.atomic_add(sums_out, wall, 3 + axis, wp.float64(turn[axis]))
                        wp.atomic_add(sums_out, wall, 6, wp.float64(work))

    return push_out
