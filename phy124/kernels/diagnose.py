"""Sums that tell whether a run is sound: momentum, energy, volume ratio, work done from outside.

All sums are float64. The state is weighed once per frame; what forces and walls give is summed in
every substep, because it depends on the path. The kinetic energy counts what APIC keeps in C:
m/2 (|v|^2 + dx^2/4 |C|^2), the inertia of a quadratic B-spline (Jiang et al. 2017, eq. 12).
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.spectral import to_double
from phy124.kernels.transfer import Law, types

SUMS = 12
"""Momentum 3, angular momentum 3, kinetic and elastic energy, mass times position 3, power."""
GIVEN = 5
"""Impulse 3, work, sum of the sizes of all impulses."""


@wp.func
def wide(a: Any):
    """A three-vector in float64."""
    return wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))


@wp.func
def add3(sums: wp.array(dtype=wp.float64), at: int, a: wp.vec3d):
    """Add a vector to three sums."""
    wp.atomic_add(sums, at, a[0])
    wp.atomic_add(sums, at + 1, a[1])
    wp.atomic_add(sums, at + 2, a[2])


@cache
def make_weigh(law: Law, real: Any):
    """Kernel: `SUMS` over the particles, -least and greatest J, and the unsound particles.

    The power is that of the elastic stress, V tau : C, with which kinetic energy goes into elastic.
    `counts_out` is (not finite, inside out), `first_out` the lowest index of each.
    """
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    energy, stress = law.energy, law.stress
    exact = wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @wp.kernel(module=f"phy124_weigh_{law.name}_{real.__name__}", enable_backward=False)
    def weigh(
        # model
        theta: wp.array(dtype=theta_type), mass: wp.array(dtype=real),
        volume: wp.array(dtype=real), dx: real, start: int,
        # state in
        x: wp.array(dtype=t.vec3), v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        F: wp.array(dtype=t.mat33), history: wp.array(dtype=t.vec2),
        # out
        sums_out: wp.array(dtype=wp.float64), range_out: wp.array(dtype=wp.float64),
        counts_out: wp.array(dtype=int), first_out: wp.array(dtype=int),
    ):  # fmt: skip
        p = wp.tid()
        h = wp.vec2d()
        if wp.static(has_history):
            h = wp.vec2d(wp.float64(history[p][0]), wp.float64(history[p][1]))
        # In float64: the energy of a small strain is the difference of large numbers.
        row = wp.min(p, theta.shape[0] - 1)
        parameters = exact()
        for i in range(wp.static(law.width)):
            parameters[i] = wp.float64(theta[row][i])
        deformation = to_double(F[p])
        J = wp.determinant(deformation)
        psi = energy(deformation, h, parameters)
        m = wp.float64(mass[p])
        spread = wp.float64(dx * dx) / wp.float64(4.0)
        here = wide(x[p])
        moving = wide(v[p])
        rate = C[p]
        affine = wp.float64(wp.ddot(rate, rate))
        kinetic = m / wp.float64(2.0) * (wp.dot(moving, moving) + spread * affine)
        if wp.isfinite(kinetic + psi + J + wp.length(here)):
            axial = wp.vec3d(
                wp.float64(rate[2, 1] - rate[1, 2]),
                wp.float64(rate[0, 2] - rate[2, 0]),
                wp.float64(rate[1, 0] - rate[0, 1]),
            )
            add3(sums_out, 0, m * moving)
            add3(sums_out, 3, m * (wp.cross(here, moving) + spread * axial))
            wp.atomic_add(sums_out, 6, kinetic)
            wp.atomic_add(sums_out, 7, psi * wp.float64(volume[p]))
            add3(sums_out, 8, m * here)
            tau = stress(deformation, wp.mat33d(), h, parameters)
            power = wp.ddot(tau, to_double(rate)) * wp.float64(volume[p])
            wp.atomic_add(sums_out, 11, power)
            wp.atomic_max(range_out, 0, -J)
            wp.atomic_max(range_out, 1, J)
            if J <= wp.float64(0.0):
                wp.atomic_add(counts_out, 1, 1)
                wp.atomic_min(first_out, 1, start + p)
        else:
            wp.atomic_add(counts_out, 0, 1)
            wp.atomic_min(first_out, 0, start + p)

    return weigh


@cache
def make_energies(law: Law, real: Any):
    """Kernel: kinetic and elastic energy of each particle [J]; to find one, not to sum them."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    energy, exact = law.energy, wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @wp.kernel(module=f"phy124_energies_{law.name}_{real.__name__}", enable_backward=False)
    def energies(
        # model
        theta: wp.array(dtype=theta_type), mass: wp.array(dtype=real),
        volume: wp.array(dtype=real), dx: real,
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        F: wp.array(dtype=t.mat33), history: wp.array(dtype=t.vec2),
        # out
        energy_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        p = wp.tid()
        h = wp.vec2d()
        if wp.static(has_history):
            h = wp.vec2d(wp.float64(history[p][0]), wp.float64(history[p][1]))
        row = wp.min(p, theta.shape[0] - 1)
        parameters = exact()
        for i in range(wp.static(law.width)):
            parameters[i] = wp.float64(theta[row][i])
        psi = energy(to_double(F[p]), h, parameters)
        spread = wp.float64(dx * dx) / wp.float64(4.0)
        square = wp.dot(wide(v[p]), wide(v[p])) + spread * wp.float64(wp.ddot(C[p], C[p]))
        half = wp.float64(mass[p]) / wp.float64(2.0)
        energy_out[p] = half * square + psi * wp.float64(volume[p])

    return energies


@cache
def make_push_copy(real: Any):
    """Kernel: keeps what the particles do before forces act on them."""
    t = types(real)

    @wp.kernel(module=f"phy124_push_copy_{real.__name__}", enable_backward=False)
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

    @wp.kernel(module=f"phy124_push_sums_{real.__name__}", enable_backward=False)
    def push_sums(
        # model
        mass: wp.array(dtype=real), dx: real,
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        v_kept: wp.array(dtype=t.vec3), C_kept: wp.array(dtype=t.mat33),
        # out
        given_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        p = wp.tid()
        m = wp.float64(mass[p])
        change = wide(v[p]) - wide(v_kept[p])
        spread = wp.float64(dx * dx) / wp.float64(4.0)
        affine = wp.float64(wp.ddot(C[p], C[p])) - wp.float64(wp.ddot(C_kept[p], C_kept[p]))
        square = wp.dot(change, wide(v[p]) + wide(v_kept[p])) + spread * affine
        add3(given_out, 0, m * change)
        wp.atomic_add(given_out, 3, m / wp.float64(2.0) * square)
        wp.atomic_add(given_out, 4, m * wp.length(change))

    return push_sums


@cache
def make_wall_copy(real: Any):
    """Kernel over rows of nodes in a sub-box: keeps their velocities before walls act."""
    t = types(real)

    @wp.kernel(module=f"phy124_wall_copy_{real.__name__}", enable_backward=False)
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

    @wp.kernel(module=f"phy124_wall_sums_{real.__name__}", enable_backward=False)
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
        gross = wp.float64(0.0)
        for k in range(count[2]):
            q = grid[row + k]
            if q[3] > real(0.0):
                d = q - kept[(i * count[1] + j) * count[2] + k]
                if d[0] != real(0.0) or d[1] != real(0.0) or d[2] != real(0.0):
                    J = wp.float64(q[3]) * wide(d)
                    impulse += J
                    work += wp.dot(J, wide(q))
                    gross += wp.length(J)
        if gross > wp.float64(0.0):
            add3(given_out, 0, impulse)
            wp.atomic_add(given_out, 3, work)
            wp.atomic_add(given_out, 4, gross)

    return wall_sums


@cache
def make_uniform_sums(real: Any):
    """Kernel of one thread: adds what the uniform acceleration gives in a substep.

    When it acts, forces on particles have acted in this substep and walls have not: `walls_out`
    keeps what those had given before. `base` is the momentum without what the pages hold.
    """
    t = types(real)

    @wp.kernel(module=f"phy124_uniform_sums_{real.__name__}", enable_backward=False)
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
        add3(given_out, 0, J)
        work = wp.dot(J, p + J / wp.float64(2.0)) / mass
        wp.atomic_add(given_out, 3, work)
        wp.atomic_add(given_out, 4, wp.length(J))

    return uniform_sums


@cache
def make_grid_speed(real: Any):
    """Kernel: the greatest squared speed of a node with mass; decides whether a step is taken."""
    t = types(real)

    @wp.kernel(module=f"phy124_grid_speed_{real.__name__}", enable_backward=False)
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

    @wp.kernel(module=f"phy124_limit_total_{real.__name__}", enable_backward=False)
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
    """Kernel: stress, modulus and projected F of single states, to examine a law by itself."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    stress, modulus, project = law.stress, law.modulus, law.project
    plastic = project is not None

    @wp.kernel(module=f"phy124_probe_law_{law.name}_{real.__name__}", enable_backward=False)
    def probe(
        theta: wp.array(dtype=theta_type), F: wp.array(dtype=t.mat33),
        history: wp.array(dtype=t.vec2), dt: real,
        stress_out: wp.array(dtype=t.mat33), modulus_out: wp.array(dtype=real),
        projected_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = wp.tid()
        stress_out[p] = stress(F[p], t.mat33(), history[p], theta[0])
        modulus_out[p] = modulus(F[p], history[p], theta[0])
        projected_out[p] = F[p]
        if wp.static(plastic):
            elastic, _ = project(F[p], history[p], theta[0], dt)
            projected_out[p] = elastic

    return probe


@cache
def make_reset(real: Any):
    """Kernel: deformations that no law can work with become the identity.

    Sound are volume ratios between `least` and `most`, norms up to `greatest`, and a smallest
    stretch of at least the share `narrowest` of the greatest: J / |cof F| against |F|.
    `found_out` is how many are not and the lowest index of one.
    """
    t = types(real)

    @wp.kernel(module=f"phy124_reset_{real.__name__}", enable_backward=False)
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
