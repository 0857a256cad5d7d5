"""Kernels that sum the impulses of walls on surface points, and of clamps on nodes.

The impulse of the clamps is the change of a node's momentum, minus the contact impulses on the
node. The sums are float64, since a frame may have thousands of substeps.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.lattice.contact import DRIVEN, MOMENT
from phy124.kernels.reduction import add_to
from phy124.kernels.work import IMPULSE, MOVED, TURNED, WORK


@wp.func
def add_to_clamp(
    clamps: wp.array2d(dtype=wp.float64),
    row: int,
    impulse: wp.vec3d,
    moment: wp.vec3d,
    work: wp.float64,
    driven: wp.float64,
):
    """Add an impulse, its moment and its work to the sums of a clamp.

    Threads of a warp may have different clamps, which `reduction.add_to` does not support.
    """
    for c in range(3):
        wp.atomic_add(clamps, row, IMPULSE + c, impulse[c])
        wp.atomic_add(clamps, row, MOMENT + c, moment[c])
    wp.atomic_add(clamps, row, WORK, work)
    wp.atomic_add(clamps, row, MOVED, wp.length(impulse))
    wp.atomic_add(clamps, row, TURNED, wp.abs(work))
    wp.atomic_add(clamps, row, DRIVEN, driven)


@build_once
def make_add_impulse(real: Any):
    """Kernel over points near a wall: adds the wall's impulse on each point to its sum [N s]."""

    @kernel(f"phy124_lattice_add_impulse_{real.__name__}", real, seconds=0.2)
    def add_impulse(near, force, clock, impulse_out):
        s = near[wp.tid()]
        impulse_out[s] += wide(clock[0] * force[s])

    return add_impulse


@build_once
def make_add_momentum(real: Any):
    """Kernel over nodes in clamps: adds `sign` times each node's momentum [N s] to the node's sum.

    Tied nodes have no momentum.
    """

    @kernel(f"phy124_lattice_add_momentum_{real.__name__}", real, seconds=0.2)
    def add_momentum(sign: wp.float64, held: Ints, inverse, v, impulse_out):
        n = held[wp.tid()]
        if inverse[n] > real(0.0):
            impulse_out[n] += sign / wp.float64(inverse[n]) * wide(v[n])

    return add_momentum


@build_once
def make_pass_on(real: Any):
    """Kernel over points: adds the contact impulses on nodes in clamps to the clamps' sums.

    A clamp absorbs the contact impulses on its nodes. On clamped nodes, contact impulses do no
    work, so this work is subtracted from the sums of a wall. If another body exerts the impulse,
    the clamp does work on the other body, so the work is added to the clamp's sums.

    For clamped nodes, `inverse` is zero, but `whole` is not. `holder` is the row of a node's clamp
    in `clamps_out`. `sums_out` contains the work, and `impulse_out` the impulse on each node;
    either array may be empty.
    """

    @kernel(f"phy124_lattice_pass_on_{real.__name__}", real, seconds=0.4)
    def pass_on(
        near,
        nodes,
        weights,
        inverse,
        whole,
        holder: Ints,
        rest,
        u,
        force,
        clock,
        v_before,
        v,
        sums_out,
        clamps_out: wp.array2d(dtype=wp.float64),
        impulse_out,
    ):
        s = near[wp.tid()]
        impulse = wide(clock[0] * force[s])
        if wp.dot(impulse, impulse) > wp.float64(0.0):
            for k in range(weights.shape[1]):
                n = nodes[s, k]
                if weights[s, k] != real(0.0) and inverse[n] == real(0.0) and whole[n] > real(0.0):
                    back = -wp.float64(weights[s, k]) * impulse
                    driven = wp.float64(0.0)
                    work = wp.float64(0.5) * wp.dot(back, wide(v_before[n]) + wide(v[n]))
                    if sums_out.shape[0] > 0:
                        add_to(sums_out, wp.static(WORK), work)
                        work = wp.float64(0.0)
                    else:
                        driven = work
                    moment = wp.cross(wide(rest[n]) + wide(u[n]), back)
                    add_to_clamp(clamps_out, holder[n], back, moment, work, driven)
                    if impulse_out.shape[0] > 0:
                        wp.atomic_add(impulse_out, n, back)

    return pass_on
