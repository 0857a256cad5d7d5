"""The part of the particles' motion that the grid does not carry, and how much of it they keep.

APIC forgets it in every substep, which damps. It is what is left of (v, C) after a round trip over
the grid, D = 1 - S S^+ in the notation of Hammerquist and Nairn 2017. FLIP gives it all back, AFLIP
(Fei et al. 2021) a share of it, XPIC(m) all but D^m, in which only noise is left. Here C makes the
round trip as v does, so that the trip changes neither momentum nor angular momentum.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.transfer import (
    GATHERS,
    SCATTERS,
    columns4,
    first_node,
    in_window,
    member,
    types,
)


@cache
def make_carry(real: Any, form: str):
    """Kernel: the momentum and mass of a motion (v, C) to the grid, without stress."""
    t = types(real)
    spread = SCATTERS[form]

    @kernel(f"phy124_carry_{real.__name__}_{form}", seconds=0.3)
    def carry(
        # model
        chosen: wp.array(dtype=int), mass: wp.array(dtype=real), lattice: t.vec4,
        window: wp.array(dtype=wp.vec3i),
        # state in
        x: wp.array(dtype=t.vec3), v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        # out
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        p = member(chosen, wp.tid())
        dx = lattice[3]
        g = (x[p] - wp.vector(lattice[0], lattice[1], lattice[2])) / dx
        low = first_node(g)
        f = wp.vector(g[0] - real(low[0]), g[1] - real(low[1]), g[2] - real(low[2]))
        size = window[1]
        first = low - window[0]
        if in_window(first, size):
            m = mass[p]
            cx, cy, cz = columns4(m * C[p], dx)
            mv = m * v[p]
            base = wp.vector(mv[0], mv[1], mv[2], m) - f[0] * cx - f[1] * cy - f[2] * cz
            spread(grid_out, size, first, f, base, cx, cy, cz)

    return carry


@cache
def make_fluctuation(real: Any, form: str):
    """Kernel: a motion (v, C) less what the grid carries of it; zero outside the window."""
    t = types(real)
    collect = GATHERS[form]

    @kernel(f"phy124_fluctuation_{real.__name__}_{form}", seconds=0.3)
    def fluctuation(
        # model
        chosen: wp.array(dtype=int), lattice: t.vec4, window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4), x: wp.array(dtype=t.vec3),
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        # out
        v_out: wp.array(dtype=t.vec3), C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = member(chosen, wp.tid())
        dx = lattice[3]
        g = (x[p] - wp.vector(lattice[0], lattice[1], lattice[2])) / dx
        low = first_node(g)
        f = wp.vector(g[0] - real(low[0]), g[1] - real(low[1]), g[2] - real(low[2]))
        size = window[1]
        first = low - window[0]
        dv = t.vec3()
        dC = t.mat33()
        if in_window(first, size):
            s = collect(grid, size, first, f)
            mean = wp.vector(s[0, 0], s[0, 1], s[0, 2])
            k = real(4.0) / dx
            dv = v[p] - mean
            dC = C[p] - k * wp.matrix_from_cols(
                wp.vector(s[1, 0], s[1, 1], s[1, 2]) - f[0] * mean,
                wp.vector(s[2, 0], s[2, 1], s[2, 2]) - f[1] * mean,
                wp.vector(s[3, 0], s[3, 1], s[3, 2]) - f[2] * mean,
            )
        v_out[p] = dv
        C_out[p] = dC

    return fluctuation


@cache
def make_keep(real: Any):
    """Kernel: gives particles back a share of what the grid did not carry, less the noise in it."""
    t = types(real)

    @kernel(f"phy124_keep_{real.__name__}")
    def keep(
        # model
        chosen: wp.array(dtype=int), share: real,
        # state in
        v: wp.array(dtype=t.vec3), C: wp.array(dtype=t.mat33),
        v_noise: wp.array(dtype=t.vec3), C_noise: wp.array(dtype=t.mat33),
        # in place
        v_out: wp.array(dtype=t.vec3), C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = member(chosen, wp.tid())
        v_out[p] = v_out[p] + share * (v[p] - v_noise[p])
        C_out[p] = C_out[p] + share * (C[p] - C_noise[p])

    return keep
