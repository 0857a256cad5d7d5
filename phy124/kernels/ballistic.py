"""Particles beyond the grid: they feel the uniform acceleration and nothing else."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.transfer import first_node, in_window, types


@cache
def make_fly(real: Any):
    """Kernel: kick and drift of chosen particles, as far as they are outside the window."""
    t = types(real)

    @kernel(f"phy124_fly_{real.__name__}")
    def fly(
        # model
        chosen: wp.array(dtype=int), lattice: t.vec4, window: wp.array(dtype=wp.vec3i),
        clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # state, updated in place
        x_out: wp.array(dtype=t.vec3), residue_out: wp.array(dtype=t.vec3),
        v_out: wp.array(dtype=t.vec3),
    ):  # fmt: skip
        p = chosen[wp.tid()]
        g = (x_out[p] - wp.vector(lattice[0], lattice[1], lattice[2])) / lattice[3]
        if not in_window(first_node(g) - window[0], window[1]):
            a = values[0]
            v = v_out[p] + clock[0] * wp.vector(a[0], a[1], a[2])
            change = clock[1] * v - residue_out[p]
            moved = x_out[p] + change
            residue_out[p] = (moved - x_out[p]) - change
            x_out[p] = moved
            v_out[p] = v

    return fly
