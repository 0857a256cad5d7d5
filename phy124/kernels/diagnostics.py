"""What a state adds up to: momentum, energy, volume ratio, and the particles that are unsound.

All sums are float64, of which each thread makes some by itself before it adds them to those of the
others. The kinetic energy counts what APIC keeps in C: m/2 (|v|^2 + dx^2/4 |C|^2), the inertia of a
quadratic B-spline (Jiang et al. 2017, eq. 12).
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.spectral import to_double
from phy124.kernels.transfer import Law, types

SUMS = 12
"""Momentum 3, angular momentum 3, kinetic and elastic energy, mass times position 3, power."""


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


@wp.func
def kinetic_energy(m: wp.float64, v: wp.vec3d, C: Any, dx: Any):
    """m/2 (|v|^2 + dx^2/4 |C|^2), what APIC keeps in C included [J]."""
    spread = wp.float64(dx * dx) / wp.float64(4.0)
    return m / wp.float64(2.0) * (wp.dot(v, v) + spread * wp.float64(wp.ddot(C, C)))


@wp.func
def spin(C: Any, dx: Any):
    """Angular momentum per mass that APIC keeps in C [m^2/s]."""
    spread = wp.float64(dx * dx) / wp.float64(4.0)
    return spread * wp.vec3d(
        wp.float64(C[2, 1] - C[1, 2]), wp.float64(C[0, 2] - C[2, 0]), wp.float64(C[1, 0] - C[0, 1])
    )


@cache
def make_totals(law: Law, real: Any):
    """Kernel: `SUMS` over the particles, -min J and max J, and the unsound particles.

    The power is that of the elastic stress, V tau : C, with which kinetic energy goes into elastic.
    `counts_out` is (not finite, inside out), `first_out` the lowest index of each. Each thread adds
    up `each` particles before it writes, as in `make_measure`.
    """
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    energy, stress = law.energy, law.stress
    exact, all_sums = (wp.types.vector(n, wp.float64) for n in (law.width, SUMS))
    has_history = law.project is not None

    @kernel(f"phy124_totals_{law.name}_{real.__name__}")
    def totals(
        # model
        first: int, each: int, stride: int,
        theta: wp.array(dtype=theta_type), mass: wp.array(dtype=real),
        volume: wp.array(dtype=real), dx: real, start: int,
        # state in
        x: wp.array(dtype=t.vec3), v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        F: wp.array(dtype=t.mat33), history: wp.array(dtype=t.vec2),
        # out
        sums_out: wp.array(dtype=wp.float64), range_out: wp.array(dtype=wp.float64),
        counts_out: wp.array(dtype=int), first_out: wp.array(dtype=int),
    ):  # fmt: skip
        sums = all_sums()
        min_J = wp.float64(wp.inf)
        max_J = wp.float64(-wp.inf)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < x.shape[0]:
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
                here = wide(x[p])
                moving = wide(v[p])
                kinetic = kinetic_energy(m, moving, C[p], dx)
                if wp.isfinite(kinetic + psi + J + wp.length(here)):
                    tau = stress(deformation, wp.mat33d(), h, parameters)
                    power = wp.ddot(tau, to_double(C[p])) * wp.float64(volume[p])
                    turning = wp.cross(here, moving) + spin(C[p], dx)
                    for i in range(3):
                        sums[i] += m * moving[i]
                        sums[3 + i] += m * turning[i]
                        sums[8 + i] += m * here[i]
                    sums[6] += kinetic
                    sums[7] += psi * wp.float64(volume[p])
                    sums[11] += power
                    min_J = wp.min(min_J, J)
                    max_J = wp.max(max_J, J)
                    if J <= wp.float64(0.0):
                        wp.atomic_add(counts_out, 1, 1)
                        wp.atomic_min(first_out, 1, start + p)
                else:
                    wp.atomic_add(counts_out, 0, 1)
                    wp.atomic_min(first_out, 0, start + p)
        for i in range(wp.static(SUMS)):
            wp.atomic_add(sums_out, i, sums[i])
        wp.atomic_max(range_out, 0, -min_J)
        wp.atomic_max(range_out, 1, max_J)

    return totals


@cache
def make_energies(law: Law, real: Any):
    """Kernel: kinetic and elastic energy of each particle [J]; to find one, not to sum them."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    energy, exact = law.energy, wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @kernel(f"phy124_energies_{law.name}_{real.__name__}")
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
        kinetic = kinetic_energy(wp.float64(mass[p]), wide(v[p]), C[p], dx)
        energy_out[p] = kinetic + psi * wp.float64(volume[p])

    return energies
