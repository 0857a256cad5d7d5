"""Moves particles outside the grid; only the uniform acceleration acts on these particles.

A particle that is outside the grid during the scatter is hidden from the gather. Otherwise, a
particle that crosses the window's edge during the gather would be moved twice.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.transfer import first_node, in_window

OUT_OF_SIGHT = wp.constant(4)
"""Hidden particles are placed this far below the lowest node of the grid's window [nodes]."""


@build_once
def make_hide(real: Any):
    """Kernel: hides particles that were outside the grid's window during the scatter."""
    t = types(real)

    @kernel(f"phy124_hide_{real.__name__}", real)
    def hide(
        chosen, lattice, scattered: Box, gathered: Box, x_out, kept_out: t.vec3s, away_out: Ints
    ):
        i = wp.tid()
        p = chosen[i]
        dx = lattice[3]
        origin = wp.vector(lattice[0], lattice[1], lattice[2])
        kept_out[i] = x_out[p]
        away_out[i] = 0
        if not in_window(first_node((x_out[p] - origin) / dx) - scattered[0], scattered[1]):
            away_out[i] = 1
            low = gathered[0] - wp.vec3i(OUT_OF_SIGHT)
            x_out[p] = origin + dx * wp.vector(real(low[0]), real(low[1]), real(low[2]))

    return hide


@build_once
def make_fly(real: Any):
    """Kernel: restores the positions of hidden particles, then moves them in free flight."""
    t = types(real)

    @kernel(f"phy124_fly_{real.__name__}", real)
    def fly(chosen, clock, values, kept: t.vec3s, away: Ints, x_out, residue_out, v_out):
        i = wp.tid()
        if away[i] > 0:
            p = chosen[i]
            a = values[0]
            v = v_out[p] + clock[0] * wp.vector(a[0], a[1], a[2])
            change = clock[1] * v - residue_out[p]
            moved = kept[i] + change
            residue_out[p] = (moved - kept[i]) - change
            x_out[p] = moved
            v_out[p] = v

    return fly
