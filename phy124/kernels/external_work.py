"""Sums of the impulse and work of forces and walls.

They are summed in float64 in every substep, because they depend on the path, and compared with the
change of the state (phy124/kernels/diagnostics.py).
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import add3, kinetic_energy, wide
from phy124.kernels.reduction import add_to
from phy124.kernels.rows import copy_row, next_changed, row_in_copy, row_in_grid
from phy124.kernels.transfer import types

IMPULSE, WORK, MOVED, TURNED, GIVEN = 0, 3, 4, 5, 6
"""Index of each sum (of the impulse: its first), and the number of sums.

`MOVED` and `TURNED` are the sums of the norms of all impulses and of the absolute values of work;
of forces on particles, those of what a thread has summed.
"""


@wp.func
def add_given(
    given: wp.array(dtype=wp.float64), impulse: wp.vec3d, work: wp.float64, moved: wp.float64,
    turned: wp.float64,
):  # fmt: skip
    """Add one impulse and its work to the `GIVEN` sums."""
    add3(given, IMPULSE, impulse)
    add_to(given, WORK, work)
    add_to(given, MOVED, moved)
    add_to(given, TURNED, turned)


@cache
def make_push_copy(real: Any, keeps_C: bool = False):
    """Kernel: stores v, and C unless all forces keep it, before forces act on the particles."""
    t = types(real)

    @kernel(f"phy124_push_copy_{'v' if keeps_C else 'vC'}_{real.__name__}")
    def push_copy(
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        # out
        v_out: wp.array(dtype=t.vec3), C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = wp.tid()
        v_out[p] = v[p]
        if wp.static(not keeps_C):
            C_out[p] = C[p]

    return push_copy


CHANGE = """
wp::vec_t<4, double> sums(0.0, 0.0, 0.0, 0.0);
for (int k = 0; k < each; ++k) {
    const int p = first + k * stride;
    if (p >= mass.shape[0]) break;
    const auto after = wp::index(v, p);
    const auto before = wp::index(kept, p);
    const auto change = after - before;
    const double m = wp::index(mass, p);
    for (int c = 0; c < 3; ++c) sums[c] += m * double(change[c]);
    sums[3] += m * double(wp::dot(change, after + before)) / 2.0;
}
return sums;
"""


@wp.func_native(CHANGE)
def change(
    first: int, each: int, stride: int, mass: wp.array(dtype=wp.float32),
    v: wp.array(dtype=wp.vec3), kept: wp.array(dtype=wp.vec3),
) -> wp.vec4d:  # fmt: skip
    """Change of momentum and of kinetic energy of some particles whose velocities were `kept`.

    In C++, since Warp's own code for such a loop takes three times as long on a CPU.
    """
    ...


@wp.func_native(CHANGE)
def change(  # noqa: F811
    first: int, each: int, stride: int, mass: wp.array(dtype=wp.float64),
    v: wp.array(dtype=wp.vec3d), kept: wp.array(dtype=wp.vec3d),
) -> wp.vec4d:  # fmt: skip
    """The same in float64."""
    ...


@cache
def make_push_sums_v(real: Any):
    """Kernel: as `make_push_sums` makes it, for forces that keep C, which is not read."""
    t = types(real)

    @kernel(f"phy124_push_sums_v_{real.__name__}")
    def push_sums_v(
        # model
        first: int, each: int, stride: int, mass: wp.array(dtype=real),
        # state in
        v: wp.array(dtype=t.vec3), v_kept: wp.array(dtype=t.vec3),
        # out
        given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        sums = change(wp.tid() * first, each, stride, mass, v, v_kept)
        impulse = wp.vec3d(sums[0], sums[1], sums[2])
        add_given(given_out, impulse, sums[3], wp.length(impulse), wp.abs(sums[3]))

    return push_sums_v


@cache
def make_push_sums(real: Any):
    """Kernel: adds the change of momentum and kinetic energy since `push_copy` to `GIVEN` sums."""
    t = types(real)

    @kernel(f"phy124_push_sums_vC_{real.__name__}")
    def push_sums(
        # model
        first: int, each: int, stride: int, mass: wp.array(dtype=real), dx: real,
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        v_kept: wp.array(dtype=t.vec3), C_kept: wp.array(dtype=t.mat33),
        # out
        given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
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
        add_given(given_out, impulse, work, wp.length(impulse), wp.abs(work))

    return push_sums


@cache
def make_wall_copy(real: Any):
    """Kernel over parts of rows in a box, `each` nodes long: stores what they are before walls."""
    t = types(real)

    @kernel(f"phy124_wall_copy_{real.__name__}", seconds=0.15)
    def wall_copy(
        # model
        each: int, box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4),
        # out
        kept_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        copy_row(kept_out, copy + part * each, grid, row + part * each, each)

    return wall_copy


@cache
def make_wall_sums(real: Any):
    """Kernel over the same parts: adds impulse and work of the walls to the `GIVEN` sums.

    The work of an impulse J is J . v with the velocity after it, which moves the material: zero for
    walls at rest, negative for friction. With the velocity before it, stress that presses on a wall
    without moving it would count as work.
    """
    t = types(real)

    @kernel(f"phy124_wall_sums_{real.__name__}", seconds=0.2)
    def wall_sums(
        # model
        each: int, box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4), kept: wp.array(dtype=t.vec4),
        # out
        given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
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
        add_given(given_out, impulse, work, moved, turned)

    return wall_sums


@cache
def make_uniform_sums(real: Any):
    """Kernel of one thread: adds impulse and work of the uniform acceleration in a substep.

    It acts after forces on particles and before walls, so `walls_out` stores the walls' sums up to
    the previous substep. `base` is the momentum without the open sums. Of `pushes` and `walls`,
    there is one row of sums for each worker.
    """
    t = types(real)

    @kernel(f"phy124_uniform_sums_{real.__name__}")
    def uniform_sums(
        # model
        mass: wp.float64, clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # state in
        base: wp.array(dtype=wp.float64), pushes: wp.array2d(dtype=wp.float64),
        walls: wp.array2d(dtype=wp.float64),
        # out
        walls_out: wp.array(dtype=wp.float64), given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        a = values[0]
        factor = mass * wp.float64(clock[0])
        J = factor * wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))
        p = wp.vec3d()
        for c in range(3):
            p[c] = base[c] + walls_out[c] + given_out[c]
            walls_out[c] = wp.float64(0.0)
            for worker in range(pushes.shape[0]):
                p[c] += pushes[worker, c]
            for worker in range(walls.shape[0]):
                walls_out[c] += walls[worker, c]
        work = wp.dot(J, p + J / wp.float64(2.0)) / mass
        add_given(given_out, J, work, wp.length(J), wp.abs(work))

    return uniform_sums
