"""Forces of the stress on the nodes of a lattice: f_i = -sum V P grad w_i, P = tau F^-T.

At inverted points, F^-T must have the sign of det F, unless the law has a barrier. Otherwise the
forces would not derive from the energy, and a few inverted points would add energy in every
substep.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.elastic import safe_volume, signed_volume
from phy124.kernels.lattice.points import PER_CELL, inverse_rows, slopes_at, spread_slopes
from phy124.kernels.transfer import Law

SPEED, GRADIENT, CLOSING, MAXIMA = 0, 1, 2, 3
"""Indices of the largest speed, rate of compression and closing rate."""
FLAT = wp.constant(0.05)
"""Volume ratio below which the strain rate of a flat or inverted point is reduced."""

QUADRATIC = wp.constant(2.0)
"""Coefficient of the artificial viscosity."""
STEEPEST = wp.constant(6.0)
"""Upper bound [1/cell^2] of the sum of |dw/dx|^2 / w over the nodes of a point. The bound limits
the rate at which the artificial viscosity stops a compression. The mass of a node is at least the
sum of w m over its points, so the limited rate does not depend on how much of a cell is filled.
"""


@build_once
def make_stress(law: Law, real: Any, viscous: bool):
    """Kernel over points: adds the forces due to the stress of a constitutive law to the nodes."""
    t = types(real)
    stress = law.stress
    kind = "viscous" if viscous else "elastic"

    @kernel(
        f"phy124_lattice_stress_{law.name}_{kind}_{real.__name__}",
        real,
        width=law.width,
        seconds=0.6,
    )
    def lattice_stress(start, first, low, theta, volume, dx, rows, offset, u, v, force_out):
        p = start + wp.tid()
        cell = p / wp.static(PER_CELL)
        f = offset[p]
        F = wp.identity(3, dtype=real) + slopes_at(u, rows, cell, f) / dx
        J = wp.determinant(F)
        cofactors = inverse_rows(F)
        back = cofactors / safe_volume(J)
        C = t.mat33()
        if wp.static(viscous):
            C = (slopes_at(v, rows, cell, f) / dx) * wp.transpose(back)
        tau = stress(F, C, t.vec2(), theta[wp.min(p - first, theta.shape[0] - 1)])
        if wp.static(not law.barrier):
            back = cofactors / signed_volume(J)
        P = (-volume[p] / dx) * (tau * back)
        spread_slopes(force_out, low, rows, cell, f, P)

    return lattice_stress


@build_once
def make_shock(real: Any):
    """Kernel over points: adds the forces of an artificial viscosity that resists fast compression.

    If the volume shrinks at the rate d, the pressure is `QUADRATIC` rho0 (l d)^2 (von Neumann and
    Richtmyer 1950), which spreads a shock over a few cells. The length l is the size of a cell
    times the smallest stretch of the squeezed material, so that the longest stable substep depends
    only on d. The pressure is limited, so that it only removes energy, even in a long substep.
    """

    @kernel(f"phy124_lattice_shock_{real.__name__}", real, seconds=0.4)
    def lattice_shock(start, low, mass, dx, rows, offset, clock, u, v, force_out):
        p = start + wp.tid()
        cell = p / wp.static(PER_CELL)
        f = offset[p]
        F = wp.identity(3, dtype=real) + slopes_at(u, rows, cell, f) / dx
        back = inverse_rows(F) / safe_volume(wp.determinant(F))
        rate = wp.ddot(slopes_at(v, rows, cell, f), back)
        if rate < real(0.0):
            square = wp.ddot(back, back)
            shorter = wp.max(square - real(2.0), real(1.0))
            stopping = dx / (real(STEEPEST) * square * clock[0])
            strength = wp.min(-real(QUADRATIC) * rate / shorter, stopping)
            energy = -strength * mass[p] * rate
            spread_slopes(force_out, low, rows, cell, f, (energy / dx) * back)

    return lattice_shock


@wp.func
def compression(C: Any):
    """Return an upper bound [1/s] of the rate of compression of a point along any direction.

    With the mean m of the eigenvalues of the strain rate, and the norm q of its deviator, no
    eigenvalue is below m - sqrt(2/3) q.
    """
    D = type(C[0, 0])(0.5) * (C + wp.transpose(C))
    mean = wp.trace(D) / type(C[0, 0])(3.0)
    deviator = D - mean * wp.identity(3, dtype=type(C[0, 0]))
    return wp.sqrt(wp.ddot(deviator, deviator) * type(C[0, 0])(2.0 / 3.0)) - mean


@build_once
def make_lattice_measure(real: Any):
    """Kernel over points: finds the largest speed, rate of compression, and closing rate of cells.

    The closing rate is the rate of compression times the volume ratio. In material that is squeezed
    flat, even a slow motion has a high rate of compression.
    """

    @kernel(f"phy124_lattice_measure_{real.__name__}", real, seconds=0.3)
    def lattice_measure(start, v, C, F, maxima_out, stray_out):
        p = start + wp.tid()
        fast = wp.dot(v[p], v[p])
        J = wp.determinant(F[p])
        rate = compression(C[p]) * safe_volume(J) / wp.max(J, real(FLAT))
        if not wp.isfinite(fast + rate + wp.ddot(F[p], F[p])):
            wp.atomic_add(stray_out, 0, 1)
            return
        wp.atomic_max(maxima_out, SPEED, wp.sqrt(fast))
        wp.atomic_max(maxima_out, GRADIENT, rate)
        wp.atomic_max(maxima_out, CLOSING, rate * wp.clamp(J, real(0.0), real(1.0)))

    return lattice_measure
