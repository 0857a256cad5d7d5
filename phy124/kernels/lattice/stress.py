"""Forces of the stress on the nodes of the lattice at rest: f_i = -sum V P grad w_i.

P = tau F^-T is the first Piola-Kirchhoff stress of the law's Kirchhoff stress tau.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.lattice.points import (
    PER_CELL,
    inverse_rows,
    safe_volume,
    slopes_at,
    spread_bound,
    spread_slopes,
)
from phy124.kernels.spectral import eigenvalues, to_double
from phy124.kernels.transfer import Law

SPEED, GRADIENT, MAXIMA = 0, 1, 2
"""Index of each measured maximum, and their number."""
FLATTEST = wp.constant(4.0e-4)
"""Smallest squared stretch that limits the substep: 0.02 of the length at rest."""


@cache
def make_stress(law: Law, real: Any, viscous: bool):
    """Kernel over points: adds the force of a law's stress to the nodes.

    Args:
        law: The constitutive law.
        real: wp.float32 or wp.float64.
        viscous: Whether the stress depends on the rate of strain.
    """
    t = types(real)
    stress = law.stress
    kind = "viscous" if viscous else "elastic"

    @kernel(
        f"phy124_lattice_stress_{law.name}_{kind}_{real.__name__}",
        real,
        width=law.width,
        seconds=0.6,
    )
    def lattice_stress(
        start: int,
        first: int,
        low: int,
        theta,
        volume,
        dx,
        rows: Ints,
        offset: t.vec3s,
        u: t.vec3s,
        v: t.vec3s,
        force_out: t.vec3s,
    ):
        p = start + wp.tid()
        cell = p / wp.static(PER_CELL)
        f = offset[p]
        F = wp.identity(3, dtype=real) + slopes_at(u, rows, cell, f) / dx
        back = inverse_rows(F) / safe_volume(wp.determinant(F))
        C = t.mat33()
        if wp.static(viscous):
            C = (slopes_at(v, rows, cell, f) / dx) * wp.transpose(back)
        tau = stress(F, C, t.vec2(), theta[wp.min(p - first, theta.shape[0] - 1)])
        P = (-volume[p] / dx) * (tau * back)
        spread_slopes(force_out, low, rows, cell, f, P)

    return lattice_stress


@wp.func
def nominal_modulus(A: Any, tau: Any, least: Any):
    """Return an upper bound of dP/dF [Pa] from the law's modulus A, its stress and least stretch^2.

    In principal axes dP_i/ds_i = (d tau_i / d ln s_i - tau_i) / s_i^2.
    """
    return (A + wp.sqrt(wp.ddot(tau, tau))) / least


@wp.func
def neo_hookean_nominal(J: Any, least: Any, theta: Any):
    """Return mu (1 + 1/s^2) + lam (1 - log J) / s^2: dP/ds of a neo-Hookean solid."""
    unit = type(J)(1.0)
    lam = wp.max(theta[1], type(J)(0.0))
    return theta[0] * (unit + unit / least) + lam * wp.max(unit - wp.log(J), unit) / least


@wp.func
def one_axis(A: Any, theta: Any):
    """Return the part of a modulus bound 2 mu + 3 lam that a wave along one axis meets."""
    two = type(A)(2.0)
    lam = wp.max(theta[1], type(A)(0.0))
    return A * (two * theta[0] + lam) / (two * theta[0] + type(A)(3.0) * lam)


@cache
def make_lattice_measure(law: Law, real: Any, viscous: bool):
    """Kernel over points: finds the largest speed and rate of strain, and bounds the stiffness.

    A point's stiffness is rho dx^2 / dt^2 [Pa] of the longest stable substep dt = 2 / omega (sqrt(1
    + z^2) - z), where omega^2 = 4 A / (rho dx^2) and z is the damping ratio of that vibration.
    Divided by the nodes' masses, `bound_out` [N] bounds the square of the largest frequency.
    """
    t = types(real)
    modulus, stress = law.modulus, law.stress
    neo_hookean = law.name.startswith("neo_hookean")
    kind = "viscous" if viscous else "elastic"

    @kernel(
        f"phy124_lattice_measure_{law.name}_{kind}_{real.__name__}",
        real,
        width=law.width,
        seconds=0.6,
    )
    def lattice_measure(
        start: int,
        first: int,
        theta,
        mass,
        volume,
        length: real,
        low: int,
        rows: Ints,
        offset: t.vec3s,
        v,
        C,
        F,
        bound_out: t.reals,
        maxima_out: t.reals,
        stray_out: Ints,
    ):
        p = start + wp.tid()
        deformation = F[p]
        fast = wp.dot(v[p], v[p])
        rate = wp.ddot(C[p], C[p])
        if not wp.isfinite(fast + rate + wp.ddot(deformation, deformation)):
            wp.atomic_add(stray_out, 0, 1)
            return
        parameters = theta[wp.min(p - first, theta.shape[0] - 1)]
        exact = to_double(deformation)
        stretches = eigenvalues(wp.transpose(exact) * exact)
        least = wp.max(real(stretches[2]), real(FLATTEST))
        J = safe_volume(wp.determinant(deformation))
        A = real(0.0)
        if wp.static(neo_hookean):
            A = neo_hookean_nominal(J, least, parameters)
        else:
            tau = stress(deformation, t.mat33(), t.vec2(), parameters)
            A = nominal_modulus(
                one_axis(modulus(deformation, t.vec2(), parameters), parameters), tau, least
            )
        stiffness = A * volume[p] / mass[p]
        if wp.static(viscous):
            # z = eta omega / (A s^2), with omega = 2 sqrt(A / rho) / dx.
            eta = parameters[wp.static(law.width - 1)]
            z = real(2.0) * eta * wp.sqrt(volume[p] / (mass[p] * A)) / (length * least)
            shorter = wp.sqrt(real(1.0) + z * z) - z
            stiffness = stiffness / (shorter * shorter)
        wp.atomic_max(maxima_out, SPEED, wp.sqrt(fast))
        wp.atomic_max(maxima_out, GRADIENT, wp.sqrt(rate))
        cell = p / wp.static(PER_CELL)
        spread_bound(bound_out, low, rows, cell, offset[p], stiffness * mass[p])

    return lattice_measure
