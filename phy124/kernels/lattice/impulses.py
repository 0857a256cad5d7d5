"""Kernels that sum impulses: of walls on each surface point, and of clamps on each node.

A point's contact force acts over the kick of a substep. The impulse of clamps on a node is the
change of its momentum while they act: `make_add_momentum` first subtracts its momentum, and then
adds it. Both sums are float64, since a frame may have thousands of substeps. The threads of a
kernel have different points or nodes, so the result does not depend on their order.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide

Impulses = wp.array(dtype=wp.vec3d)


@build_once
def make_add_impulse(real: Any):
    """Kernel over the points near a wall: adds the wall's impulse in a substep [N s]."""
    t = types(real)

    @kernel(f"phy124_lattice_add_impulse_{real.__name__}", real, seconds=0.2)
    def add_impulse(near: Ints, force: t.vec3s, clock, impulse_out: Impulses):
        s = near[wp.tid()]
        impulse_out[s] += wide(clock[0] * force[s])

    return add_impulse


@build_once
def make_add_momentum(real: Any):
    """Kernel over held nodes: adds momenta times `sign` [N s]; tied nodes have none."""
    t = types(real)

    @kernel(f"phy124_lattice_add_momentum_{real.__name__}", real, seconds=0.2)
    def add_momentum(
        sign: wp.float64, held: Ints, inverse: t.reals, v: t.vec3s, impulse_out: Impulses
    ):
        n = held[wp.tid()]
        if inverse[n] > real(0.0):
            impulse_out[n] += sign / wp.float64(inverse[n]) * wide(v[n])

    return add_momentum
