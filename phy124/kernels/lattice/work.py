"""Sums the work of forces on nodes and the work of contact, for each cause separately.

The work of an impulse is the impulse times the mean of the velocities before and after the substep.
The work of all impulses then adds up to the change of the nodes' kinetic energy.
"""

from typing import Any

import warp as wp

from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import xyz
from phy124.kernels.diagnostics import wide
from phy124.kernels.lattice.nodes import force_on
from phy124.kernels.reduction import add_to
from phy124.kernels.work import add_exchange

STRESS, UNIFORM, PUSHED, VISCOUS, SHOCK = 0, 1, 2, 3, 4
"""Indices of the work [J] of the total stress, the uniform acceleration, the forces on points, and
two parts of the stress (viscosity and artificial viscosity).
"""
WALLS, ITSELF, PAIRS, SOLIDS = 5, 8, 11, 14
"""Index of the first of three sums of work [J] for contact with walls, of a body with itself,
between bodies, and with freely moving rigid solids. A freely moving rigid solid counts as a wall at
rest.
"""
DRIVEN, PRESSED, RUBBED = 0, 1, 2
"""Offsets among these three sums: work by the wall's motion, by normal impulses, and by tangential
impulses. The last two are computed with the velocity relative to the wall.
"""


@build_once
def make_node_work(real: Any):
    """Kernel over the nodes from `start` on: adds the work of forces to the sum with index `at`.

    The work of the uniform acceleration is added to the sum `UNIFORM`. Tied nodes move with their
    donors, so forces on tied nodes act on the donors (phy124/kernels/lattice/nodes.py).
    """

    @kernel(f"phy124_lattice_node_work_{real.__name__}", real, seconds=0.3)
    def node_work(
        start, at: int, inverse, pool, spans, donors, clock, values, v_before, v, sums_out
    ):
        n = start + wp.tid()
        forced = wp.float64(0.0)
        uniform = wp.float64(0.0)
        if inverse[n] > real(0.0):
            force = force_on(pool, spans, donors, n)
            way = wp.float64(0.5) * wp.float64(clock[0]) * (wide(v_before[n]) + wide(v[n]))
            forced = wp.dot(wide(force), way)
            uniform = wp.dot(wide(values[0]), way) / wp.float64(inverse[n])
        add_to(sums_out, at, forced)
        add_to(sums_out, wp.static(UNIFORM), uniform)

    return node_work


@build_once
def make_push_work(real: Any):
    """Kernel over chosen nodes: adds forces on points to `EXCHANGE` sums."""

    @kernel(f"phy124_lattice_push_work_{real.__name__}", real, seconds=0.3)
    def push_work(
        first, each, stride, chosen, inverse, pool, spans, donors, clock, v_before, v, exchange_out
    ):
        impulse = wp.vec3d()
        work = wp.float64(0.0)
        for k in range(each):
            i = wp.tid() * first + k * stride
            if i >= chosen.shape[0]:
                break
            n = chosen[i]
            if inverse[n] > real(0.0):
                force = force_on(pool, spans, donors, n)
                J = wp.float64(clock[0]) * wide(force)
                impulse += J
                work += wp.float64(0.5) * wp.dot(J, wide(v_before[n]) + wide(v[n]))
        add_exchange(exchange_out, impulse, work, wp.length(impulse), wp.abs(work))

    return push_work


@build_once
def make_contact_work(real: Any):
    """Single-thread kernel: adds the work of contact impulses on points to the sums `at` to `at` +
    2.

    These are the work of the wall's motion, of the normal impulses, and of friction. `gap` contains
    the normals, and `rates[slot]` is the velocity of the wall. Impulses do not act on nodes whose
    `inverse` is zero.
    """

    @kernel(f"phy124_lattice_contact_work_{real.__name__}", real, seconds=0.3)
    def contact_work(
        near,
        count,
        at: int,
        slot,
        nodes,
        weights,
        inverse,
        gap,
        force,
        clock,
        rates,
        v_before,
        v,
        sums_out,
    ):
        wall = wide(rates[slot])
        for a in range(count):
            s = near[a]
            impulse = wp.float64(clock[0]) * wide(force[s])
            if wp.dot(impulse, impulse) > wp.float64(0.0):
                share = wp.float64(0.0)
                mean = wp.vec3d()
                for k in range(weights.shape[1]):
                    n = nodes[s, k]
                    if inverse[n] > real(0.0):
                        w = wp.float64(weights[s, k])
                        share += w
                        mean += wp.float64(0.5) * w * (wide(v_before[n]) + wide(v[n]))
                normal = wide(xyz(gap[s]))
                driven = share * wp.dot(impulse, wall)
                pressed = wp.dot(impulse, normal) * wp.dot(normal, mean - share * wall)
                sums_out[at] = sums_out[at] + driven
                sums_out[at + 1] = sums_out[at + 1] + pressed
                sums_out[at + 2] = sums_out[at + 2] + wp.dot(impulse, mean) - driven - pressed

    return contact_work
