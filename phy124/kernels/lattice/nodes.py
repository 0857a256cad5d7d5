"""Kernels that accelerate, clamp and move the nodes of a lattice.

A node with almost no mass is tied: it follows heavier nodes, its donors. Two sparse matrices store
these constraints: `donors` lists the tied nodes that depend on each node, and `tied` lists the
donors of each tied node.

`pool` contains the forces from all workers. `spans` contains three numbers for each worker: the
first node on which the worker's forces act, the node after the last, and the index in `pool` of the
force on the first node.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import ANGULAR, KINETIC, MIDDLE, MOMENTUM, add3, wide
from phy124.kernels.lattice.contact import DRIVEN, MOMENT
from phy124.kernels.reduction import add_to
from phy124.kernels.work import add_exchange

RECENT = wp.constant(0.75)
"""Viscosity acts on a weighted mean of the present velocity (with this weight) and the velocity one
substep earlier. A vibration whose sign changes in every substep is then damped half as much, and
the longest stable substep is shortened half as much. With a smaller weight, vibrations whose sign
changes every second substep would grow.
"""


@wp.func
def sum_workers(pool: wp.array(dtype=Any), spans: wp.array(dtype=wp.vec3i), n: int):
    """Return the force on a node: the sum over all workers, always in the same order."""
    total = wp.vector(length=3, dtype=type(pool[0][0]))
    for w in range(spans.shape[0]):
        span = spans[w]
        if n >= span[0] and n < span[1]:
            total += pool[span[2] + n - span[0]]
    return total


@wp.func
def force_on(pool: wp.array(dtype=Any), spans: wp.array(dtype=wp.vec3i), donors: Any, n: int):
    """Return the force on a node, including forces on nodes that are tied to it."""
    force = sum_workers(pool, spans, n)
    for k in range(donors.starts[n], donors.starts[n + 1]):
        force += donors.weights[k] * sum_workers(pool, spans, donors.nodes[k])
    return force


@build_once
def make_kick(real: Any):
    """Kernel over the nodes `start` to `stop`: changes the velocities by forces and gravity."""

    @kernel(f"phy124_lattice_kick_{real.__name__}", real, seconds=0.3)
    def kick(start, stop, inverse, pool, spans, donors, clock, values, v_out, v_before_out):
        n = start + wp.tid()
        v_before_out[n] = v_out[n]
        if inverse[n] > real(0.0):
            force = force_on(pool, spans, donors, n)
            a = wp.vector(values[0][0], values[0][1], values[0][2])
            v_out[n] = v_out[n] + clock[0] * (inverse[n] * force + a)

    return kick


@build_once
def make_copy(real: Any):
    """Kernel over the nodes from `start` on: copies their velocities."""
    t = types(real)

    @kernel(f"phy124_lattice_copy_{real.__name__}", real, seconds=0.1)
    def copy(start, v: t.vec3s, copy_out: t.vec3s):
        n = start + wp.tid()
        copy_out[n] = v[n]

    return copy


@build_once
def make_try(real: Any):
    """Kernel over the nodes from `start` on: computes a trial displacement, and displaces the
    nodes.

    The new trial displacement is `gain` times the old one plus `share` times the accelerations. The
    nodes move by `size` times the trial displacement; tied nodes follow their donors.
    """
    t = types(real)

    @kernel(f"phy124_lattice_try_{real.__name__}", real, seconds=0.3)
    def lattice_try(
        start,
        gain: real,
        share: real,
        size: real,
        tied,
        u,
        a: t.vec3s,
        shape: t.vec3s,
        mixed_out: t.vec3s,
        trial_out: t.vec3s,
    ):
        n = start + wp.tid()
        mixed = gain * shape[n] + share * a[n]
        mixed_out[n] = mixed
        for k in range(tied.starts[n], tied.starts[n + 1]):
            donor = tied.nodes[k]
            mixed += tied.weights[k] * (gain * shape[donor] + share * a[donor])
        trial_out[n] = u[n] + size * mixed

    return lattice_try


@build_once
def make_compare(real: Any):
    """Kernel over the nodes from `start` on: subtracts the accelerations `trial` from `a`."""
    t = types(real)

    @kernel(f"phy124_lattice_compare_{real.__name__}", real, seconds=0.2)
    def lattice_compare(start, a: t.vec3s, trial: t.vec3s, shape_out: t.vec3s):
        n = start + wp.tid()
        shape_out[n] = a[n] - trial[n]

    return lattice_compare


@wp.func
def any_active(slots: wp.array2d(dtype=int), i: int, values: wp.array(dtype=Any)):
    """Return whether a clamp is active; `slots[i]` are tracks of clamps, or -1 for no clamp."""
    for k in range(slots.shape[1]):
        slot = slots[i, k]
        if slot >= 0:
            if values[slot][3] > type(values[slot][3])(0.0):
                return True
    return False


@build_once
def make_hold(real: Any):
    """Kernel over the nodes in a clamp: sets their velocities while the clamp's track is active.

    `movable_out` receives the inverse mass of nodes that contact may move, and 0 for nodes in the
    clamp. `holder_out` receives the row of a node's clamp. Nodes of an active clamp in `others` are
    skipped, so that the work of each clamp is computed with the nodes' final velocities.
    """
    t = types(real)

    @kernel(f"phy124_lattice_hold_{real.__name__}", real, seconds=0.3)
    def hold(
        held: Ints,
        others: wp.array2d(dtype=int),
        row: int,
        slot,
        inverse,
        rest,
        u,
        values,
        rates,
        v_before,
        v_out,
        movable_out: t.reals,
        holder_out: Ints,
        sums_out,
    ):
        n = held[wp.tid()]
        if any_active(others, wp.tid(), values):
            return
        if values[slot][3] > real(0.0):
            rate = wp.vector(rates[slot][0], rates[slot][1], rates[slot][2])
            if inverse[n] > real(0.0):
                mass = wp.float64(1.0) / wp.float64(inverse[n])
                impulse = mass * (wide(rate) - wide(v_out[n]))
                at = wide(rest[n]) + wide(u[n])
                work = wp.float64(0.5) * wp.dot(impulse, wide(rate) + wide(v_before[n]))
                add_exchange(sums_out, impulse, work, wp.length(impulse), wp.abs(work))
                add3(sums_out, wp.static(MOMENT), wp.cross(at, impulse))
                add_to(sums_out, wp.static(DRIVEN), wp.dot(impulse, wide(rate)))
            v_out[n] = rate
            movable_out[n] = real(0.0)
            holder_out[n] = row
        else:
            movable_out[n] = inverse[n]

    return hold


@build_once
def make_pin(real: Any):
    """Kernel over pairs of a clamped and a free node: stops the motion at the clamp's surface.

    The interpolated velocity is zero at the surface if the clamped node's velocity relative to the
    clamp is `ratio` times the free node's relative velocity. Momenta are projected onto such
    motions (phy124/kernels/columns.py). If another clamp fixes the free node, only the velocity of
    the clamped node changes. If another clamp fixes the clamped node, neither velocity changes.
    """
    t = types(real)

    @kernel(f"phy124_lattice_pin_{real.__name__}", real, seconds=0.3)
    def pin(
        pairs: wp.array(dtype=wp.vec2i),
        ratio: t.reals,
        others_of_held: wp.array2d(dtype=int),
        others_of_free: wp.array2d(dtype=int),
        row: int,
        slot,
        inverse,
        rest,
        u,
        values,
        rates,
        v_before,
        v_out,
        movable_out: t.reals,
        holder_out: Ints,
        sums_out,
    ):
        i = wp.tid()
        held = pairs[i][0]
        free = pairs[i][1]
        leads = any_active(others_of_free, i, values)
        if not leads:
            movable_out[free] = inverse[free]
        if any_active(others_of_held, i, values):
            return
        movable_out[held] = inverse[held]
        if values[slot][3] > real(0.0) and inverse[held] > real(0.0) and inverse[free] > real(0.0):
            # If contact moved only one of the two nodes, the motion at the clamp's surface would no
            # longer be zero.
            movable_out[held] = real(0.0)
            movable_out[free] = real(0.0)
            holder_out[held] = row
            wall = wp.vec3d(wp.vector(rates[slot][0], rates[slot][1], rates[slot][2]))
            g = wp.float64(ratio[i])
            m = wp.vec2d(
                wp.float64(1.0) / wp.float64(inverse[held]),
                wp.float64(1.0) / wp.float64(inverse[free]),
            )
            held_before = wide(v_out[held])
            free_before = wide(v_out[free])
            momentum = g * m[0] * (held_before - wall) + m[1] * (free_before - wall)
            motion = momentum / (g * g * m[0] + m[1])
            if leads:
                motion = free_before - wall
            else:
                v_out[free] = t.vec3(wall + motion)
                holder_out[free] = row
            v_out[held] = t.vec3(wall + g * motion)
            first = m[0] * (wide(v_out[held]) - held_before)
            second = m[1] * (wide(v_out[free]) - free_before)
            half = wp.float64(0.5)
            work = half * wp.dot(first, wide(v_out[held]) + wide(v_before[held]))
            work += half * wp.dot(second, wide(v_out[free]) + wide(v_before[free]))
            impulse = first + second
            add_exchange(sums_out, impulse, work, wp.length(impulse), wp.abs(work))
            moment = wp.cross(wide(rest[held]) + wide(u[held]), first)
            moment += wp.cross(wide(rest[free]) + wide(u[free]), second)
            add3(sums_out, wp.static(MOMENT), moment)
            add_to(sums_out, wp.static(DRIVEN), wp.dot(impulse, wall))

    return pin


@build_once
def make_drift(real: Any):
    """Kernel over the nodes `start` to `stop`: moves the nodes. Tied nodes follow heavier nodes.

    `lagging_out` receives the velocity on which viscosity acts in the next substep (`RECENT`).
    """
    t = types(real)

    @kernel(f"phy124_lattice_drift_{real.__name__}", real, seconds=0.3)
    def drift(start, stop, tied, clock, v_before, v_out, u_out, residue_out, lagging_out):
        n = start + wp.tid()
        if tied.starts[n + 1] > tied.starts[n]:
            v = t.vec3()
            for k in range(tied.starts[n], tied.starts[n + 1]):
                v += tied.weights[k] * v_out[tied.nodes[k]]
            v_out[n] = v
        lagging_out[n] = real(RECENT) * v_out[n] + (real(1.0) - real(RECENT)) * v_before[n]
        # Compensated summation, so that small steps are not lost next to a large displacement.
        step = clock[1] * v_out[n] + residue_out[n]
        last = u_out[n]
        after = last + step
        residue_out[n] = step - (after - last)
        u_out[n] = after

    return drift


@build_once
def make_node_totals(real: Any):
    """Kernel over nodes: sums momenta, angular momenta, kinetic energy, and mass times position."""

    @kernel(f"phy124_lattice_node_totals_{real.__name__}", real, seconds=0.3)
    def node_totals(inverse, rest, u, v, sums_out):
        n = wp.tid()
        if inverse[n] > real(0.0):
            mass = wp.float64(1.0) / wp.float64(inverse[n])
            at = wide(rest[n]) + wide(u[n])
            momentum = mass * wide(v[n])
            add3(sums_out, MOMENTUM, momentum)
            add3(sums_out, ANGULAR, wp.cross(at, momentum))
            add3(sums_out, MIDDLE, mass * at)
            add_to(sums_out, KINETIC, wp.float64(0.5) * wp.dot(momentum, wide(v[n])))

    return node_totals
