"""Exchange of momentum between grid nodes and a free body."""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import coulomb
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.free.numbers import (
    ANGULAR,
    EXCHANGE,
    GUESS,
    IMPULSE,
    KICKED,
    LINEAR,
    MOMENT,
    MOVED,
    PLACE,
    PRIOR,
    SYSTEM,
    TURNED,
    TURNING,
    VELOCITY,
    WALLS,
    WORK,
    A,
    B,
    C,
    arm_of,
    at3,
    axes,
    first_node,
    moving,
    put3,
    spin_of,
)
from phy124.kernels.reduction import add_to
from phy124.kernels.window import strides


@wp.func
def shares(relative: wp.vec3d, n: wp.vec3d, friction: wp.float64, sticky: int):
    """Return the fractions of a node's velocity relative to a surface that contact removes.

    The first fraction applies along the normal out of the body, the second perpendicular to the
    normal.
    """
    if sticky == 1:
        return wp.vec2d(wp.float64(1.0), wp.float64(1.0))
    approach = wp.dot(relative, n)
    if approach <= wp.float64(0.0):
        return wp.vec2d()
    return wp.vec2d(wp.float64(1.0), coulomb(relative - approach * n, approach, friction))


@build_once
def make_begin(real: Any):
    """Single-thread kernel: applies gravity once per substep; initialises the solution."""

    @kernel(f"phy124_free_begin_{real.__name__}", real)
    def begin(moments, clock, values, body_out, trial_out):
        if body_out[KICKED] == wp.float64(0.0):
            pull = wp.float64(clock[0]) * wide(values[0])
            put3(body_out, VELOCITY, at3(body_out, VELOCITY) + pull)
            body_out[KICKED] = wp.float64(1.0)
        put3(trial_out, GUESS, at3(body_out, VELOCITY))
        put3(trial_out, GUESS + 3, spin_of(axes(body_out), moments, at3(body_out, ANGULAR)))

    return begin


@build_once
def make_assemble(real: Any):
    """Kernel over rows of nodes around a free body: adds contact to its equations of motion."""
    numbers = wp.types.vector(SYSTEM, wp.float64)

    @kernel(f"phy124_free_assemble_{real.__name__}", real, seconds=0.6)
    def assemble(
        reach: int,
        friction: wp.float64,
        sticky,
        lattice,
        window,
        body,
        trial,
        contact,
        grid,
        system_out,
    ):
        i, j = wp.tid()
        first = first_node(body, lattice, reach)
        sums = numbers()
        some = int(0)
        for k in range(contact.shape[2]):
            here = contact[i, j, k]
            if here[3] > real(0.0):
                node = first + wp.vec3i(i, j, k)
                q = grid[wp.dot(node - window[0], strides(window[1]))]
                r = arm_of(body, lattice, node)
                n = wide(here)
                v = wide(q)
                part = shares(moving(trial, GUESS, r) - v, n, friction, sticky)
                if part[0] > wp.float64(0.0):
                    some = 1
                    m = wp.float64(q[3])
                    across = m * part[1]
                    W = across * wp.identity(n=3, dtype=wp.float64)
                    W += (m * part[0] - across) * wp.outer(n, n)
                    G = -wp.skew(r)
                    WG = W @ G
                    turning = wp.transpose(G) @ WG
                    p = W @ v
                    moment = wp.cross(r, p)
                    for a in range(3):
                        sums[LINEAR + a] += p[a]
                        sums[TURNING + a] += moment[a]
                        for b in range(3):
                            sums[A + 3 * a + b] += W[a, b]
                            sums[B + 3 * a + b] += WG[a, b]
                            sums[C + 3 * a + b] += turning[a, b]
        if some == 1:
            for a in range(wp.static(SYSTEM)):
                add_to(system_out, a, sums[a])

    return assemble


@build_once
def make_apply(real: Any):
    """Kernel over rows of nodes around a free body: changes the velocities of the nodes in contact.

    `exchange_out` collects the impulses on the nodes as `EXCHANGE` sums, with the moment about the
    body's centre.
    """
    t = types(real)
    numbers = wp.types.vector(EXCHANGE, wp.float64)

    @kernel(f"phy124_free_apply_{real.__name__}", real, seconds=0.4)
    def apply(
        reach: int,
        friction: wp.float64,
        sticky,
        lattice,
        window,
        body,
        trial,
        contact,
        grid_out,
        exchange_out,
    ):
        i, j = wp.tid()
        first = first_node(body, lattice, reach)
        sums = numbers()
        for k in range(contact.shape[2]):
            here = contact[i, j, k]
            if here[3] > real(0.0):
                node = first + wp.vec3i(i, j, k)
                index = wp.dot(node - window[0], strides(window[1]))
                q = grid_out[index]
                r = arm_of(body, lattice, node)
                n = wide(here)
                v = wide(q)
                part = shares(moving(trial, PRIOR, r) - v, n, friction, sticky)
                if part[0] > wp.float64(0.0):
                    wanted = moving(trial, GUESS, r) - v
                    change = part[1] * wanted + (part[0] - part[1]) * wp.dot(wanted, n) * n
                    now = t.vec4(
                        q[0] + real(change[0]), q[1] + real(change[1]), q[2] + real(change[2]), q[3]
                    )
                    grid_out[index] = now
                    J = wp.float64(q[3]) * (wide(now) - v)
                    moment = wp.cross(r, J)
                    work = wp.dot(J, wide(now))
                    for a in range(3):
                        sums[IMPULSE + a] += J[a]
                        sums[MOMENT + a] += moment[a]
                    sums[WORK] += work
                    sums[MOVED] += wp.length(J)
                    sums[TURNED] += wp.abs(work)
        if sums[MOVED] > wp.float64(0.0):
            for a in range(wp.static(EXCHANGE)):
                add_to(exchange_out, a, sums[a])

    return apply


@build_once
def make_finish(real: Any):
    """Single-thread kernel: changes a free body's momentum by the impulses of walls and nodes.

    `total_out` accumulates the impulses on the nodes of one grid since the start, with the moment
    about the origin of the world.
    """

    @kernel(f"phy124_free_finish_{real.__name__}", real)
    def finish(mass: wp.float64, trial, exchange_out, body_out, total_out: Doubles):
        J = at3(exchange_out, IMPULSE)
        moment = at3(exchange_out, MOMENT)
        put3(body_out, VELOCITY, at3(body_out, VELOCITY) + (at3(trial, WALLS) - J) / mass)
        put3(body_out, ANGULAR, at3(body_out, ANGULAR) + at3(trial, WALLS + 3) - moment)
        add3(total_out, MOMENT, wp.cross(at3(body_out, PLACE), J))
        for a in range(wp.static(EXCHANGE)):
            total_out[a] += exchange_out[a]
            exchange_out[a] = wp.float64(0.0)

    return finish
