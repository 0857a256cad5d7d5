"""Sums the impulse and work of forces and walls, and the work of the material's stress.

Impulse and work depend on the path, so they are summed in every substep, in float64. The stress in
a substep is the mean of the stresses at its start and its end. This mean is correct to second order
for elastic material, and equals the yield stress during plastic flow.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import add3, kinetic_energy, wide
from phy124.kernels.grid import copy_row, next_changed, row_in_copy, row_in_grid
from phy124.kernels.native import code
from phy124.kernels.reduction import add_to
from phy124.kernels.spectral import to_double
from phy124.kernels.transfer import Law, member

IMPULSE, WORK, MOVED, TURNED, EXCHANGE = 0, 3, 4, 5, 6
"""`MOVED` is the sum of the norms of all impulses, and `TURNED` the sum of the absolute values of
work. For forces on particles, each term of these sums is itself a sum over a thread's particles.
`EXCHANGE` is the number of sums.
"""


@wp.func
def add_exchange(
    sums: wp.array(dtype=wp.float64),
    impulse: wp.vec3d,
    work: wp.float64,
    moved: wp.float64,
    turned: wp.float64,
):
    """Add an impulse and its work to the `EXCHANGE` sums."""
    add3(sums, IMPULSE, impulse)
    add_to(sums, WORK, work)
    add_to(sums, MOVED, moved)
    add_to(sums, TURNED, turned)


@build_once
def make_push_copy(real: Any, keeps_C: bool = False):
    """Kernel: stores v, and also C if a force changes C, before forces act on the particles."""

    @kernel(f"phy124_push_copy_{'v' if keeps_C else 'vC'}_{real.__name__}", real)
    def push_copy(v, C, v_out, C_out):
        p = wp.tid()
        v_out[p] = v[p]
        if wp.static(not keeps_C):
            C_out[p] = C[p]

    return push_copy


for kinds in (types(wp.float32), types(wp.float64)):

    @wp.func_native(code("reduction:change"))
    def change(
        first: int, each: int, stride: int, mass: kinds.reals, v: kinds.vec3s, kept: kinds.vec3s
    ) -> wp.vec4d:
        """Return the changes of momentum and kinetic energy since the velocities `kept` were
        stored.
        """
        ...


@build_once
def make_push_sums_v(real: Any):
    """Kernel: version of `make_push_sums` for forces that do not change C."""

    @kernel(f"phy124_push_sums_v_{real.__name__}", real)
    def push_sums_v(first, each, stride, mass, v, v_kept, exchange_out):
        sums = change(wp.tid() * first, each, stride, mass, v, v_kept)
        impulse = wp.vec3d(sums[0], sums[1], sums[2])
        add_exchange(exchange_out, impulse, sums[3], wp.length(impulse), wp.abs(sums[3]))

    return push_sums_v


@build_once
def make_push_sums(real: Any):
    """Kernel: adds the changes of momentum and energy by forces on particles to `EXCHANGE` sums."""
    t = types(real)

    @kernel(f"phy124_push_sums_vC_{real.__name__}", real)
    def push_sums(first, each, stride, mass, dx, v, C, v_kept, C_kept: t.mat33s, exchange_out):
        impulse = wp.vec3d()
        work = wp.float64(0.0)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < mass.shape[0]:
                m = wp.float64(mass[p])
                after = wide(v[p])
                before = wide(v_kept[p])
                impulse += m * (after - before)
                work += kinetic_energy(m, after, C[p], dx)
                work -= kinetic_energy(m, before, C_kept[p], dx)
        add_exchange(exchange_out, impulse, work, wp.length(impulse), wp.abs(work))

    return push_sums


@build_once
def make_wall_copy(real: Any):
    """Kernel: stores a copy of the nodes in a box before walls act."""

    @kernel(f"phy124_wall_copy_{real.__name__}", real, seconds=0.15)
    def wall_copy(each, box, window, grid, kept_out):
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        copy_row(kept_out, copy + part * each, grid, row + part * each, each)

    return wall_copy


@build_once
def make_wall_sums(real: Any):
    """Kernel: adds the impulse and the work of walls on the nodes of a box to the `EXCHANGE` sums.

    The work of an impulse J is J . v with the velocity v after the impulse, since this velocity
    moves the material. With the velocity before the impulse, stress that presses on a wall without
    moving the wall would count as work.
    """

    @kernel(f"phy124_wall_sums_{real.__name__}", real, seconds=0.2)
    def wall_sums(each, box, window, grid, kept, exchange_out):
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        impulse = wp.vec3d()
        work = wp.float64(0.0)
        moved = wp.float64(0.0)
        turned = wp.float64(0.0)
        end = part * each + each
        k = next_changed(grid, row, kept, copy, part * each, end)
        while k < end:
            q = grid[row + k]
            if q[3] > real(0.0):
                J = wp.float64(q[3]) * wide(q - kept[copy + k])
                gain = wp.dot(J, wide(q))
                impulse += J
                work += gain
                moved += wp.length(J)
                turned += wp.abs(gain)
            k = next_changed(grid, row, kept, copy, k + 1, end)
        add_exchange(exchange_out, impulse, work, moved, turned)

    return wall_sums


@build_once
def make_uniform_sums(real: Any):
    """Single-thread kernel: adds the uniform acceleration's impulse and work in a substep to sums.

    `walls_out` stores the walls' sums up to the previous substep. `mean_pushes` and `mean_walls`
    contain the impulses and the work on lattices and projected liquids; this work is computed with
    the mean velocities of a step. `base` is the momentum without the impulses in these arrays. Each
    array has one row of sums per worker, except `mean_walls`: one row per wall for a lattice, and a
    single row for a liquid. `solids` contains the impulses of freely moving solids on lattices.
    `pairs` contains the impulses of the first body of each pair on the second body. `signs` is 1 or
    -1 for pairs whose first or second body is fixed, and 0 for all other pairs.
    """

    @kernel(f"phy124_uniform_sums_{real.__name__}", real)
    def uniform_sums(
        mass: wp.float64,
        clock,
        values,
        base: Doubles,
        pushes: wp.array2d(dtype=wp.float64),
        walls: wp.array2d(dtype=wp.float64),
        mean_pushes: wp.array2d(dtype=wp.float64),
        mean_walls: wp.array2d(dtype=wp.float64),
        solids: wp.array2d(dtype=wp.float64),
        pairs: wp.array2d(dtype=wp.float64),
        signs: Doubles,
        walls_out: Doubles,
        exchange_out,
    ):
        a = values[0]
        change = wp.float64(clock[0]) * wp.vec3d(
            wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2])
        )
        J = mass * change
        p = wp.vec3d()
        for c in range(3):
            before = walls_out[3 + c]
            p[c] = base[c] + walls_out[c] + before + exchange_out[c]
            walls_out[c] = wp.float64(0.0)
            walls_out[3 + c] = wp.float64(0.0)
            for worker in range(pushes.shape[0]):
                p[c] += pushes[worker, c]
            for worker in range(walls.shape[0]):
                walls_out[c] += walls[worker, c]
            for row in range(mean_pushes.shape[0]):
                walls_out[3 + c] += mean_pushes[row, c]
            for row in range(mean_walls.shape[0]):
                walls_out[3 + c] += mean_walls[row, c]
            for row in range(solids.shape[0]):
                walls_out[3 + c] += solids[row, c]
            for row in range(pairs.shape[0]):
                walls_out[3 + c] += signs[row] * pairs[row, c]
            p[c] += (walls_out[3 + c] - before) / wp.float64(2.0)
        work = wp.dot(change, p + J / wp.float64(2.0))
        add_exchange(exchange_out, J, work, wp.length(J), wp.abs(work))

    return uniform_sums


RUBBED, STRAINED, LOST = 0, 1, 2
"""Indices of the work [J] of rate-dependent and of other stress, and the number of sums."""


@build_once
def make_dissipation(law: Law, real: Any):
    """Kernel: adds the work of the stress to the `LOST` sums; must run right after a gather."""
    stress, exact = law.stress, wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @kernel(f"phy124_dissipation_{law.name}_{real.__name__}", real, width=law.width)
    def dissipation(
        first,
        each,
        stride,
        count,
        chosen,
        theta,
        volume,
        clock,
        C,
        F,
        history,
        stress_out: wp.array(dtype=wp.mat33d),
        sums_out,
    ):
        rubbed = wp.float64(0.0)
        strained = wp.float64(0.0)
        dt = wp.float64(clock[1])
        for k in range(each):
            i = wp.tid() * first + k * stride
            if i < count:
                p = member(chosen, i)
                h = wp.vec2d()
                if wp.static(has_history):
                    h = wp.vec2d(wp.float64(history[p][0]), wp.float64(history[p][1]))
                row = wp.min(p, theta.shape[0] - 1)
                parameters = exact()
                for c in range(wp.static(law.width)):
                    parameters[c] = wp.float64(theta[row][c])
                rate = to_double(C[p])
                here = to_double(F[p])
                still = stress(here, wp.mat33d(), h, parameters)
                moving = stress(here, rate, h, parameters)
                mean = wp.float64(0.5) * (stress_out[p] + still)
                stress_out[p] = still
                share = dt * wp.float64(volume[p])
                rubbed += share * wp.ddot(moving - still, rate)
                strained += share * wp.ddot(mean, rate)
        add_to(sums_out, RUBBED, rubbed)
        add_to(sums_out, STRAINED, strained)

    return dissipation
