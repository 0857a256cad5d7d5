"""Measures momentum, energy and volume ratios of a state; detects and resets invalid particles.

All sums are in float64. The kinetic energy includes the energy of APIC's C: m/2 (|v|^2 + dx^2/4
|C|^2), with the inertia of a quadratic B-spline (Jiang et al. 2017, eq. 12).
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.elastic import largest_stretch_squared, safe_volume, signed_volume
from phy124.kernels.reduction import add_to, raise_to
from phy124.kernels.spectral import to_double
from phy124.kernels.transfer import Law

MOMENTUM, ANGULAR, KINETIC, ELASTIC, MIDDLE, POWER, SUMS = 0, 3, 6, 7, 8, 11, 12
"""`MIDDLE` is the sum of mass times position, `POWER` the power of the elastic stress, V tau : C,
and `SUMS` the number of sums. A vector's index is that of its first component.
"""
LEAST_J, LARGEST_J = 0, 1
"""The smallest J is stored as the maximum of -J."""
BROKEN, INVERTED = 0, 1
"""`BROKEN` particles have non-finite values."""


@wp.func
def wide(a: Any):
    """Convert a three-vector to float64."""
    return wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))


@wp.func
def add3(sums: wp.array(dtype=wp.float64), at: int, a: wp.vec3d):
    """Add the components of a vector to three consecutive sums."""
    add_to(sums, at, a[0])
    add_to(sums, at + 1, a[1])
    add_to(sums, at + 2, a[2])


@wp.func
def kinetic_energy(m: wp.float64, v: wp.vec3d, C: Any, dx: Any):
    """Return m/2 (|v|^2 + dx^2/4 |C|^2) [J]."""
    spread = wp.float64(dx * dx) / wp.float64(4.0)
    return m / wp.float64(2.0) * (wp.dot(v, v) + spread * wp.float64(wp.ddot(C, C)))


@wp.func
def spin(C: Any, dx: Any):
    """Return the angular momentum per unit mass that APIC stores in C [m^2/s]."""
    spread = wp.float64(dx * dx) / wp.float64(4.0)
    return spread * wp.vec3d(
        wp.float64(C[2, 1] - C[1, 2]), wp.float64(C[0, 2] - C[2, 0]), wp.float64(C[1, 0] - C[0, 1])
    )


@build_once
def make_totals(law: Law, real: Any, on_lattice: bool = False):
    """Kernel: sums momentum, energy and the other `SUMS` over particles; counts invalid particles.

    On lattices, C of inverted points is divided by a small positive number instead of by J
    (`safe_volume`). If the law has no barrier, the nodal forces of inverted points change sign
    (lattice/stress.py), so the power changes sign, too.

    `counts_out` receives the number of invalid particles of each kind, and `first_out` the lowest
    index of each kind.
    """
    energy, stress = law.energy, law.stress
    exact, all_sums = (wp.types.vector(n, wp.float64) for n in (law.width, SUMS))
    has_history = law.project is not None
    signed = on_lattice and not law.barrier
    where = "_signed" if signed else ""

    @kernel(f"phy124_totals_{law.name}{where}_{real.__name__}", real, width=law.width, seconds=0.65)
    def totals(
        first,
        each,
        stride,
        theta,
        mass,
        volume,
        dx,
        start,
        x,
        v,
        C,
        F,
        history,
        sums_out,
        range_out: Doubles,
        counts_out,
        first_out: Ints,
    ):
        sums = all_sums()
        min_J = wp.float64(wp.inf)
        max_J = wp.float64(-wp.inf)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < x.shape[0]:
                h = wp.vec2d()
                if wp.static(has_history):
                    h = wp.vec2d(wp.float64(history[p][0]), wp.float64(history[p][1]))
                # In float64, because the energy of a small strain is a small difference of large
                # numbers.
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
                    if wp.static(signed):
                        power *= safe_volume(J) / signed_volume(J)
                    turning = wp.cross(here, moving) + spin(C[p], dx)
                    for i in range(3):
                        sums[MOMENTUM + i] += m * moving[i]
                        sums[ANGULAR + i] += m * turning[i]
                        sums[MIDDLE + i] += m * here[i]
                    sums[KINETIC] += kinetic
                    sums[ELASTIC] += psi * wp.float64(volume[p])
                    sums[POWER] += power
                    min_J = wp.min(min_J, J)
                    max_J = wp.max(max_J, J)
                    if J <= wp.float64(0.0):
                        wp.atomic_add(counts_out, INVERTED, 1)
                        wp.atomic_min(first_out, INVERTED, start + p)
                else:
                    wp.atomic_add(counts_out, BROKEN, 1)
                    wp.atomic_min(first_out, BROKEN, start + p)
        for i in range(wp.static(SUMS)):
            add_to(sums_out, i, sums[i])
        raise_to(range_out, LEAST_J, -min_J)
        raise_to(range_out, LARGEST_J, max_J)

    return totals


@build_once
def make_energies(law: Law, real: Any):
    """Kernel: computes the sum of kinetic and elastic energy of each particle [J]."""
    energy, exact = law.energy, wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @kernel(f"phy124_energies_{law.name}_{real.__name__}", real, width=law.width)
    def energies(theta, mass, volume, dx, v, C, F, history, energy_out: Doubles):
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


@build_once
def make_probe(law: Law, real: Any):
    """Kernel: evaluates stress, modulus, energy and return mapping of a law for many states."""
    t = types(real)
    stress, modulus, energy, project = law.stress, law.modulus, law.energy, law.project
    plastic = project is not None

    @kernel(f"phy124_probe_{law.name}_{real.__name__}", real, width=law.width)
    def probe(
        theta,
        dt: real,
        F,
        C,
        history,
        stress_out: t.mat33s,
        modulus_out: t.reals,
        energy_out: t.reals,
        projected_out: t.mat33s,
        history_out,
    ):
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


@build_once
def make_reset(real: Any):
    """Kernel: sets invalid deformations, which no law can handle, to the identity.

    A deformation F is valid if J is between `min_J` and `max_J`, if |F| is at most `max_norm`, and
    if J / |cof F|, an estimate of the smallest stretch, is at least `narrowest` |F|. `faults_out`
    receives the number and the lowest index of the invalid deformations.
    """
    t = types(real)

    @kernel(f"phy124_reset_{real.__name__}", real, seconds=0.2)
    def reset(min_J: real, max_J: real, max_norm: real, narrowest: real, F_out, C_out, faults_out):
        p = wp.tid()
        deformation = F_out[p]
        a = wp.cross(deformation[1], deformation[2])
        b = wp.cross(deformation[2], deformation[0])
        c = wp.cross(deformation[0], deformation[1])
        J = wp.dot(deformation[0], a)
        size = wp.sqrt(wp.ddot(deformation, deformation))
        cofactor = wp.sqrt(wp.dot(a, a) + wp.dot(b, b) + wp.dot(c, c))
        # A comparison with NaN is false, so the condition tests for valid deformations.
        if not (
            J >= min_J and J <= max_J and size <= max_norm and J >= narrowest * size * cofactor
        ):
            F_out[p] = wp.identity(3, dtype=real)
            C_out[p] = t.mat33()
            wp.atomic_add(faults_out, 0, 1)
            wp.atomic_min(faults_out, 1, p)

    return reset


@build_once
def make_limit_total(real: Any):
    """Kernel: scales down the F of fluid or plastic material, so that F does not overflow."""

    @kernel(f"phy124_limit_total_{real.__name__}", real, seconds=0.15)
    def limit_total(max_norm: real, F, total_out):
        p = wp.tid()
        size = wp.sqrt(wp.ddot(total_out[p], total_out[p]))
        if not wp.isfinite(size):
            total_out[p] = F[p]
        elif size > max_norm:
            total_out[p] = (max_norm / size) * total_out[p]

    return limit_total


@build_once
def make_apart(real: Any):
    """Kernel: counts particles stretched so far that they lose contact with their neighbours.

    `most` is the square of the stretch above which particles lose contact. `faults_out` receives
    the number and the lowest index of these particles; `max_out` the largest stretch.
    """
    t = types(real)

    @kernel(f"phy124_apart_{real.__name__}", real, seconds=0.2)
    def apart(most: t.reals, start, F, faults_out, max_out: t.reals):
        p = wp.tid()
        square = largest_stretch_squared(F[p])
        if square > most[p]:
            wp.atomic_add(faults_out, 0, 1)
            wp.atomic_min(faults_out, 1, start + p)
            wp.atomic_max(max_out, 0, wp.sqrt(square))

    return apart


@build_once
def make_neighbours_lost(real: Any):
    """Kernel: marks each particle that is too far from one of its initial neighbours.

    `square` is the square of the distance [m^2]. Thread i sets `lost_out[i]` to 1 if the particle
    `chosen[i]` has lost one of `neighbours[i]`, else to 0.
    """
    t = types(real)

    @kernel(f"phy124_lost_{real.__name__}", real, seconds=0.2)
    def neighbours_lost(
        square: t.real,
        chosen,
        neighbours: wp.array2d(dtype=wp.int32),
        x,
        lost_out: wp.array(dtype=wp.uint8),
    ):
        i = wp.tid()
        here = x[chosen[i]]
        lost = wp.uint8(0)
        for k in range(neighbours.shape[1]):
            if wp.length_sq(x[neighbours[i, k]] - here) > square:
                lost = wp.uint8(1)
        lost_out[i] = lost

    return neighbours_lost
