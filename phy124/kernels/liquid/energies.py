"""Sums the work on a liquid for each cause: viscosity, pressure, walls, and density correction.

The work of an impulse is the impulse times the mean of the velocities at the start and the end of
the step. The work of all causes then adds up to the change of a face's kinetic energy. Faces behind
walls and above the surface may carry mass of the particles, so the work on such faces is counted,
too.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import kinetic_energy, wide
from phy124.kernels.liquid.faces import cell_of, entry, inner, stride, sums
from phy124.kernels.reduction import add_to
from phy124.kernels.work import add_exchange

VISCOUS, PRESSED, SHIFTED = 0, 1, 2
"""Indices of three sums [J]: work of viscosity, of the pressure, and of the uniform acceleration
along the displacements that restore the density.
"""
AT_DRAG, AT_PRESSURE, AT_END = 3, 5, 7
"""Indices of the work of walls in a step: up to the drag, up to the pressure, and up to the end.
This work is computed with the velocities of the walls. The next index (such as `AT_DRAG + 1`) is
the same work, computed with the velocities of the liquid.
"""


@build_once
def make_keep(real: Any):
    """Kernel over cells: copies the velocities to another array."""

    @kernel(f"phy124_liquid_keep_{real.__name__}", real)
    def keep(worker, active, ends, velocity, velocity_out):
        n = entry(active, ends, worker, wp.tid())
        if n >= 0:
            velocity_out[n] = velocity[n]

    return keep


@wp.func
def acts(open: wp.array(dtype=Any), liquid: wp.array(dtype=int), n: int, axis: int, step: int):
    """Return 1 if pressure acts on the face between the cells n - `step` and n, otherwise 0."""
    wet = liquid[n] + liquid[n - step] > 0
    return wp.where(wet and open[n][axis] > type(open[n][axis])(0.0), 1, 0)


@wp.func
def pressed_outside(
    open: wp.array(dtype=Any),
    liquid: wp.array(dtype=int),
    cells: wp.array(dtype=Any),
    before: wp.array(dtype=Any),
    velocity: wp.array(dtype=Any),
    n: int,
    axis: int,
    size: wp.vec3i,
):
    """Return the velocity change of a face on which no pressure acts: the mass-weighted mean
    change, by the pressure, of the adjacent faces on which pressure acts.
    """
    gain = type(velocity[n][axis])(0.0)
    mass = type(gain)(0.0)
    across = stride(axis, size)
    for along in range(3):
        for side in range(2):
            m = n + (2 * side - 1) * stride(along, size)
            if acts(open, liquid, m, axis, across) == 1:
                gain += cells[m][4 + axis] * (velocity[m][axis] - before[m][axis])
                mass += cells[m][4 + axis]
    if mass > type(gain)(0.0):
        gain /= mass
    return gain


@wp.func
def gain_at(gains: wp.array(dtype=Any), n: int, axis: int, step: int, count: int):
    """Return the velocity change at a face due to forces on particles in its two cells."""
    total = gains[n] + gains[n - step]
    for k in range(n + count, gains.shape[0], count):
        total += gains[k] + gains[k - step]
    gain = total[axis]
    if total[3] > type(gain)(0.0):
        gain /= total[3]
    return gain


@build_once
def make_face_work(real: Any):
    """Kernel over cells: adds the work of viscosity and pressure on the low faces to `sums_out`.

    `before` contains the velocities before the pressure acts, `velocity` the velocities afterwards,
    and `after` the velocities at the end of the step. `known` contains a bit for each face that has
    a velocity. The velocities at the start of the step do not include the step's `gains`.
    """
    t = types(real)
    vec8 = sums(real)

    @kernel(f"phy124_liquid_face_work_{real.__name__}", real, seconds=0.3)
    def face_work(
        worker,
        active,
        ends,
        viscosity,
        window,
        clock,
        values,
        open,
        liquid,
        known,
        cells: wp.array(dtype=vec8),
        gains,
        before: t.vec4s,
        velocity,
        after: t.vec4s,
        sums_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        if not inner(cell_of(n, size), size, 3):
            return
        q = cells[n]
        a = values[0]
        viscous = wp.float64(0.0)
        pressed = wp.float64(0.0)
        for axis in range(3):
            m = q[4 + axis]
            if m > real(0.0) and known[n] & (1 << axis) > 0:
                first = q[axis] / m
                both = first + after[n][axis]
                if gains.shape[0] > 0:
                    both -= gain_at(gains, n, axis, stride(axis, size), before.shape[0])
                mean = wp.float64(m) * wp.float64(0.5) * wp.float64(both)
                change = velocity[n][axis] - (first + clock[0] * a[axis])
                by_pressure = change
                if acts(open, liquid, n, axis, stride(axis, size)) == 1:
                    by_pressure = velocity[n][axis] - before[n][axis]
                elif viscosity > real(0.0):
                    by_pressure = pressed_outside(
                        open, liquid, cells, before, velocity, n, axis, size
                    )
                viscous += mean * wp.float64(change - by_pressure)
                pressed += mean * wp.float64(by_pressure)
        add_to(sums_out, VISCOUS, viscous)
        add_to(sums_out, PRESSED, pressed)

    return face_work


@build_once
def make_wall_work(real: Any):
    """Single-thread kernel: adds the work of the first `count` walls in this step to `sums_out`.

    `at` is the index of the sum computed with the walls' velocities; the next sum is computed with
    the liquid's velocities.
    """

    @kernel(f"phy124_liquid_wall_work_{real.__name__}", real)
    def wall_work(at: int, count: int, motions, impulses: wp.array2d(dtype=wp.float64), sums_out):
        for wall in range(count):
            J = wp.vec3d(impulses[wall, 0], impulses[wall, 1], impulses[wall, 2])
            sums_out[at] = sums_out[at] + wp.dot(J, wide(motions[wall, 0]))
            sums_out[at + 1] = sums_out[at + 1] + impulses[wall, 6]

    return wall_work


@build_once
def make_shift_work(real: Any):
    """Kernel: adds `sign` times the sum of mass times acceleration times position to `sums_out`.

    Two launches add the work of displacements: with the sign -1 before particles are displaced, and
    with the sign 1 afterwards.
    """

    @kernel(f"phy124_liquid_shift_work_{real.__name__}", real, seconds=0.2)
    def shift_work(sign: real, first, each, stride, mass, values, x, sums_out):
        q = values[0]
        a = wp.vec3d(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]))
        total = wp.float64(0.0)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < mass.shape[0]:
                total += wp.float64(mass[p]) * wp.dot(a, wide(x[p]))
        add_to(sums_out, SHIFTED, wp.float64(sign) * total)

    return shift_work


@build_once
def make_push_work(real: Any):
    """Kernel: adds impulse and work of forces on particles to the `EXCHANGE` sums after a step.

    `v_kept` and `C_kept` are values before the forces act; `v_pushed` and `C_pushed` are values
    afterwards. The arrays of C are empty if no force changes C.
    """
    t = types(real)

    @kernel(f"phy124_liquid_push_work_{real.__name__}", real, seconds=0.2)
    def push_work(
        first,
        each,
        stride,
        mass,
        dx,
        v,
        C,
        v_kept: t.vec3s,
        v_pushed: t.vec3s,
        C_kept: t.mat33s,
        C_pushed: t.mat33s,
        exchange_out,
    ):
        impulse = wp.vec3d()
        work = wp.float64(0.0)
        half = wp.float64(0.5)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < mass.shape[0]:
                m = wp.float64(mass[p])
                gain = wide(v_pushed[p]) - wide(v_kept[p])
                mean = half * (wide(v_kept[p]) + wide(v[p]))
                impulse += m * gain
                work += m * wp.dot(gain, mean)
                if C_kept.shape[0] > 0:
                    turned = C_pushed[p] - C_kept[p]
                    both = turned + real(0.5) * (C_kept[p] + C[p])
                    still = wp.vec3d()
                    work += kinetic_energy(m, still, both, dx)
                    work -= kinetic_energy(m, still, turned, dx)
                    work -= kinetic_energy(m, still, both - turned, dx)
        add_exchange(exchange_out, impulse, work, wp.length(impulse), wp.abs(work))

    return push_work
