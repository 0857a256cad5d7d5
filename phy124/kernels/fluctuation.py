"""Controls the damping of the transfers: FLIP, AFLIP and XPIC reduce the damping; RPIC increases
it.

The fluctuation is (v, C) minus the result of a transfer of (v, C) to the grid and back: D (v, C)
with D = 1 - S S^+ (Hammerquist and Nairn 2017). APIC discards the fluctuation in every substep. C
is transferred together with v, so that momentum and angular momentum do not change.
docs/design/physics.md describes the schemes.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.transfer import (
    GATHERS,
    SCATTERS,
    columns4,
    in_window,
    member,
    motion_of,
    place_in,
)


@build_once
def make_carry(real: Any, form: str):
    """Kernel: scatters the momentum and mass of a motion (v, C) to the grid, without stress."""
    spread = SCATTERS[form]

    @kernel(f"phy124_carry_{real.__name__}_{form}", real, seconds=0.3)
    def carry(chosen, mass, lattice, window, x, v, C, grid_out):
        p = member(chosen, wp.tid())
        dx = lattice[3]
        size = window[1]
        first, f = place_in(x[p], lattice, window)
        if in_window(first, size):
            m = mass[p]
            cx, cy, cz = columns4(m * C[p], dx)
            mv = m * v[p]
            base = wp.vector(mv[0], mv[1], mv[2], m) - f[0] * cx - f[1] * cy - f[2] * cz
            spread(grid_out, size, first, f, base, cx, cy, cz)

    return carry


@build_once
def make_fluctuation(real: Any, form: str):
    """Kernel: computes the part of (v, C) that a transfer to the grid and back loses; 0 outside the
    grid.
    """
    t = types(real)
    collect = GATHERS[form]

    @kernel(f"phy124_fluctuation_{real.__name__}_{form}", real, seconds=0.3)
    def fluctuation(chosen, lattice, window, grid, x, v, C, v_out, C_out):
        p = member(chosen, wp.tid())
        size = window[1]
        first, f = place_in(x[p], lattice, window)
        dv = t.vec3()
        dC = t.mat33()
        if in_window(first, size):
            mean, gradient = motion_of(collect(grid, size, first, f), f, lattice[3])
            dv = v[p] - mean
            dC = C[p] - gradient
        v_out[p] = dv
        C_out[p] = dC

    return fluctuation


@build_once
def make_keep(real: Any):
    """Kernel: adds a fraction of the fluctuation, minus the noise in the fluctuation, to v and
    C.
    """
    t = types(real)

    @kernel(f"phy124_keep_{real.__name__}", real)
    def keep(chosen, share: real, v, C, v_noise: t.vec3s, C_noise: t.mat33s, v_out, C_out):
        p = member(chosen, wp.tid())
        v_out[p] = v_out[p] + share * (v[p] - v_noise[p])
        C_out[p] = C_out[p] + share * (C[p] - C_noise[p])

    return keep


@wp.func
def decay(x: Any):
    """Return 1 - exp(-x), accurate to rounding even for small x."""
    t = wp.tanh(type(x)(0.5) * x)
    return type(x)(2.0) * t / (type(x)(1.0) + t)


@wp.func
def without_strain(C: Any, share: Any):
    """Subtract a fraction of the symmetric part of C from C; a skew C does not change."""
    return C - (type(share)(0.5) * share) * (C + wp.transpose(C))


@build_once
def make_rpic(real: Any):
    """Kernel: lets the symmetric part of C decay as exp(-rate t), with the rate in 1/s."""

    @kernel(f"phy124_rpic_{real.__name__}", real)
    def rpic(chosen, rate: real, clock, C_out):
        p = member(chosen, wp.tid())
        C_out[p] = without_strain(C_out[p], decay(rate * clock[0]))

    return rpic
