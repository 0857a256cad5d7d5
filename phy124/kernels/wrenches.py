"""Wrenches: impulse and its moment that one wall gives to the nodes in a substep, in float64."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.rows import row_in_copy, row_in_grid
from phy124.kernels.transfer import types

IMPULSE, MOMENT, SUMS = 0, 3, 6
"""Index of the first component of each sum, and the number of sums."""


@cache
def make_wall_wrench(real: Any):
    """Kernel over the parts of `make_wall_copy`: adds what a wall has given since then.

    The moment of an impulse is taken about the origin of the world. The gather keeps the angular
    momentum of the nodes (APIC, Jiang et al. 2015), so it is what the material is given.
    """
    t = types(real)

    @kernel(f"phy124_wall_wrench_{real.__name__}", seconds=0.2)
    def wall_wrench(
        # model
        lattice: t.vec4, each: int, box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4), kept: wp.array(dtype=t.vec4),
        # out
        sums_out: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        origin = wide(wp.vector(lattice[0], lattice[1], lattice[2]))
        dx = wp.float64(lattice[3])
        impulse = wp.vec3d()
        moment = wp.vec3d()
        for k in range(part * each, part * each + each):
            q = grid[row + k]
            if q[3] > real(0.0):
                d = q - kept[copy + k]
                if d[0] != real(0.0) or d[1] != real(0.0) or d[2] != real(0.0):
                    node = window[0] + box[0] + wp.vec3i(i, j, k)
                    at = origin + dx * wp.vec3d(
                        wp.float64(node[0]), wp.float64(node[1]), wp.float64(node[2])
                    )
                    J = wp.float64(q[3]) * wide(d)
                    impulse += J
                    moment += wp.cross(at, J)
        add3(sums_out, IMPULSE, impulse)
        add3(sums_out, MOMENT, moment)

    return wall_wrench
