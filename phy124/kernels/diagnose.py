"""Sums that tell whether a run is sound: impulse and work that forces and walls give.

They are summed in float64 in every substep, because they depend on the path, and weighed against
what the state gained (phy124/kernels/diagnostics.py). Also single states, speeds of nodes, and
resets.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import add3, kinetic_energy, wide
from phy124.kernels.transfer import Law, types

GIVEN = 6
"""Impulse 3, work, and the sums of the sizes of all impulses and of all works."""


@wp.func
def add_given(
    given: wp.array(dtype=wp.float64), impulse: wp.vec3d, work: wp.float64, moved: wp.float64,
    turned: wp.float64,
):  # fmt: skip
    """Add to `GIVEN` sums."""
    add3(given, 0, impulse)
    wp.atomic_add(given, 3, work)
    wp.atomic_add(given, 4, moved)
    wp.atomic_add(given, 5, turned)


@cache
def make_push_copy(real: Any):
    """Kernel: keeps what the particles do before forces act on them."""
    t = types(real)

    @kernel(f"phy124_push_copy_{real.__name__}")
    def push_copy(
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        # out
        v_out: wp.array(dtype=t.vec3), C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = wp.tid()
        v_out[p] = v[p]
        C_out[p] = C[p]

    return push_copy


@cache
def make_push_sums(real: Any):
    """Kernel: adds the change of momentum and kinetic energy since `push_copy` to `GIVEN` sums."""
    t = types(real)

    @kernel(f"phy124_push_sums_{real.__name__}")
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
        moved = wp.float64(0.0)
        turned = wp.float64(0.0)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < mass.shape[0]:
                m = wp.float64(mass[p])
                now = wide(v[p])
                before = wide(v_kept[p])
                gain = kinetic_energy(m, now, C[p], dx) - kinetic_energy(m, before, C_kept[p], dx)
                impulse += m * (now - before)
                work += gain
                moved += m * wp.length(now - before)
                turned += wp.abs(gain)
        add_given(given_out, impulse, work, moved, turned)

    return push_sums


@cache
def make_wall_copy(real: Any):
    """Kernel over rows of nodes in a sub-box: keeps their velocities before walls act."""
    t = types(real)

    @kernel(f"phy124_wall_copy_{real.__name__}")
    def wall_copy(
        # model
        box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # grid in
        grid: wp.array(dtype=t.vec4),
        # out
        kept_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j = wp.tid()
        size = window[1]
        low = box[0]
        count = box[1]
        row = ((i + low[0]) * size[1] + j + low[1]) * size[2] + low[2]
        for k in range(count[2]):
            kept_out[(i * count[1] + j) * count[2] + k] = grid[row + k]

    return wall_copy


@cache
def make_wall_sums(real: Any):
    """Kernel over the same rows: adds what the walls give to `GIVEN` sums.

    The work of an impulse J is J . v with the velocity after it, which moves the material: zero
    for walls at rest, negative for friction. With the velocity before it, stress that presses on
    a wall in vain would count as work.
    """
    t = types(real)

    @kernel(f"phy124_wall_sums_{real.__name__}")
    def wall_sums(
        # model
        box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # grid in
        grid: wp.array(dtype=t.vec4), kept: wp.array(dtype=t.vec4),
        # out
        given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        i, j = wp.tid()
        size = window[1]
        low = box[0]
        count = box[1]
        row = ((i + low[0]) * size[1] + j + low[1]) * size[2] + low[2]
        impulse = wp.vec3d()
        work = wp.float64(0.0)
        moved = wp.float64(0.0)
        turned = wp.float64(0.0)
        for k in range(count[2]):
            q = grid[row + k]
            if q[3] > real(0.0):
                d = q - kept[(i * count[1] + j) * count[2] + k]
                if d[0] != real(0.0) or d[1] != real(0.0) or d[2] != real(0.0):
                    J = wp.float64(q[3]) * wide(d)
                    gain = wp.dot(J, wide(q))
                    impulse += J
                    work += gain
                    moved += wp.length(J)
                    turned += wp.abs(gain)
        if moved > wp.float64(0.0):
            add_given(given_out, impulse, work, moved, turned)

    return wall_sums


@cache
def make_uniform_sums(real: Any):
    """Kernel of one thread: adds what the uniform acceleration gives in a substep.

    When it acts, forces on particles have acted in this substep and walls have not: `walls_out`
    keeps what those had given before. `base` is the momentum without what the pages hold.
    """
    t = types(real)

    @kernel(f"phy124_uniform_sums_{real.__name__}")
    def uniform_sums(
        # scalars
        mass: wp.float64, clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # in
        base: wp.array(dtype=wp.float64), push: wp.array(dtype=wp.float64),
        wall_a: wp.array(dtype=wp.float64), wall_b: wp.array(dtype=wp.float64),
        # out
        walls_out: wp.array(dtype=wp.float64), given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        a = values[0]
        factor = mass * wp.float64(clock[0])
        J = factor * wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))
        p = wp.vec3d()
        for c in range(3):
            p[c] = base[c] + push[c] + walls_out[c] + given_out[c]
            walls_out[c] = wall_a[c] + wall_b[c]
        work = wp.dot(J, p + J / wp.float64(2.0)) / mass
        add_given(given_out, J, work, wp.length(J), wp.abs(work))

    return uniform_sums


@cache
def make_grid_speed(real: Any):
    """Kernel: the greatest squared speed of a node with mass; decides whether a step is taken."""
    t = types(real)

    @kernel(f"phy124_grid_speed_{real.__name__}")
    def grid_speed(grid: wp.array(dtype=t.vec4), fastest_out: wp.array(dtype=real)):
        q = grid[wp.tid()]
        if q[3] > real(0.0):
            square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
            # A comparison with NaN is false: it must not pass for slow.
            if not wp.isfinite(square):
                square = real(1.0e38)
            if square > fastest_out[0]:
                wp.atomic_max(fastest_out, 0, square)

    return grid_speed


@cache
def make_limit_total(real: Any):
    """Kernel: F_total of material that flows for ever is scaled down before it overflows."""
    t = types(real)

    @kernel(f"phy124_limit_total_{real.__name__}")
    def limit_total(greatest: real, F: wp.array(dtype=t.mat33), total_out: wp.array(dtype=t.mat33)):
        p = wp.tid()
        size = wp.sqrt(wp.ddot(total_out[p], total_out[p]))
        if not wp.isfinite(size):
            total_out[p] = F[p]
        elif size > greatest:
            total_out[p] = (greatest / size) * total_out[p]

    return limit_total


@cache
def make_probe(law: Law, real: Any):
    """Kernel: everything a law says about single states, to examine it by itself."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    stress, modulus, energy, project = law.stress, law.modulus, law.energy, law.project
    plastic = project is not None

    @kernel(f"phy124_probe_{law.name}_{real.__name__}")
    def probe(
        theta: wp.array(dtype=theta_type), F: wp.array(dtype=t.mat33), C: wp.array(dtype=t.mat33),
        history: wp.array(dtype=t.vec2), dt: real,
        stress_out: wp.array(dtype=t.mat33), modulus_out: wp.array(dtype=real),
        energy_out: wp.array(dtype=real), projected_out: wp.array(dtype=t.mat33),
        history_out: wp.array(dtype=t.vec2),
    ):  # fmt: skip
        p = wp.tid()
        stress_out[p] = stress(F[p], C[p], history[p], theta[0])
        modulus_out[p] = modulus(F[p], history[p], theta[0])
        energy_out[p] = energy(F[p], history[p], theta[0])
        projected_out[p] = F[p]
        history_out[p] = history[p]
        if wp.static(plastic):
            elastic, after = project(F[p], history[p], theta[0], dt)
            projected_out[p] = elastic
            history_out[p] = after

    return probe


@cache
def make_reset(real: Any):
    """Kernel: deformations that no law can work with become the identity.

    Sound are volume ratios between `least` and `most`, norms up to `greatest`, and a smallest
    stretch of at least the share `narrowest` of the greatest: J / |cof F| against |F|.
    `found_out` is how many are not and the lowest index of one.
    """
    t = types(real)

    @kernel(f"phy124_reset_{real.__name__}")
    def reset(
        least: real, most: real, greatest: real, narrowest: real,
        # state, updated in place
        F_out: wp.array(dtype=t.mat33), C_out: wp.array(dtype=t.mat33),
        # out
        found_out: wp.array(dtype=int),
    ):  # fmt: skip
        p = wp.tid()
        deformation = F_out[p]
        a = wp.cross(deformation[1], deformation[2])
        b = wp.cross(deformation[2], deformation[0])
        c = wp.cross(deformation[0], deformation[1])
        J = wp.dot(deformation[0], a)
        size = wp.sqrt(wp.ddot(deformation, deformation))
        cofactor = wp.sqrt(wp.dot(a, a) + wp.dot(b, b) + wp.dot(c, c))
        # A comparison with NaN is false, so the test is for soundness.
        if not (J >= least and J <= most and size <= greatest and J >= narrowest * size * cofactor):
            F_out[p] = wp.identity(3, dtype=real)
            C_out[p] = t.mat33()
            wp.atomic_add(found_out, 0, 1)
            wp.atomic_min(found_out, 1, p)

    return reset
