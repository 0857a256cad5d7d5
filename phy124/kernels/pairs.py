"""Contact between two bodies: where both have mass at a node, their velocities there become one.

Each body has a field of velocities of its own, and an impulse acts between two at the nodes that
they share (Bardenhagen, Brackbill and Sulsky 2000; Bardenhagen et al. 2001). Its normal is that of
the gradients of both bodies' volumes (Nairn 2013), which both bodies see alike.

Nodes are shared before bodies touch, so contact needs a criterion of its own. The weights of a
quadratic B-spline have the variance dx^2 / 4 along every direction: the fraction of its volume that
a body fills around a node tells how far its surface is from there, whatever the direction. Two
surfaces meet where the fractions add up to 1. (Nairn et al. 2020 find the distance by a regression
over the particles.) A fraction is one of the mass in the body's depth, which takes account of its
edges, of its density, and of its compression. Three nodes in a row, along the axis closest to the
normal, are in contact or not together, by the one that both bodies share most; at the rim of a
contact, where the gap is curved, its mean around a node is larger than the gap at the node.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, types
from phy124.kernels.build import kernel
from phy124.kernels.collide import place, steepest, strides, xyz
from phy124.kernels.columns import coulomb
from phy124.kernels.contacts import IMPULSE, MOMENT
from phy124.kernels.diagnostics import add3, wide

LIGHTEST = wp.constant(1e-6)
"""Fraction of its volume that each body must fill to be looked at."""
NARROWEST = wp.constant(0.05)
"""Fraction of its volume that a body must fill in its depth: a half at an edge, a quarter at a
corner; less is beyond it, or a single particle."""
ROUNDING = wp.constant(0.375)
"""Part of what the gaps of four neighbours have more than that of a node by which it may be open,
where surfaces have met: 1/4 is what two splines see of a gap's curvature, more is fitted to balls
(docs/lab/contact-force.md)."""
STEEPER, TRUSTED = wp.constant(10.0), wp.constant(4.0)
"""How soon a steeper slope counts alone, and how many times as much the squared slope of a body
counts which never moves."""


@wp.func
def mass_at(grid: wp.array(dtype=Any), window: wp.array(dtype=wp.vec3i), node: wp.vec3i):
    """Mass of a body at a node of the lattice [kg]; nothing outside its window."""
    at = node - window[0]
    size = window[1]
    n = wp.dot(at, strides(size))
    inside = (
        at[0] >= 0
        and at[1] >= 0
        and at[2] >= 0
        and at[0] < size[0]
        and at[1] < size[1]
        and at[2] < size[2]
    )
    q = grid[wp.where(inside, n, 0)]
    return wp.where(inside, q[3], type(q[3])(0.0))


@wp.func
def slope(grid: wp.array(dtype=Any), window: wp.array(dtype=wp.vec3i), node: wp.vec3i, zero: Any):
    """Gradient of a body's mass at a node [kg per 32 cells], from `zero` on.

    Along each axis it is a mean of nine differences: a surface that is rough by a hundredth of a
    cell would otherwise brake what slides over it.
    """
    sum = zero
    for n in range(27):
        to = wp.vec3i(n / 9, (n / 3) % 3, n % 3) - wp.vec3i(1)
        weight = (2 - to[0] * to[0]) * (2 - to[1] * to[1]) * (2 - to[2] * to[2])
        m = type(zero[0])(weight) * mass_at(grid, window, node + to)
        sum += m * wp.vector(type(m)(to[0]), type(m)(to[1]), type(m)(to[2]))
    return sum


@wp.func
def trust(yields: Any):
    """How much the slope of a body's volume counts: more, if the body never moves."""
    return type(yields)(TRUSTED) - (type(yields)(TRUSTED) - type(yields)(1.0)) * yields


@wp.func
def normal(to: Any, away: Any, yields: Any):
    """The normal of contact, from where the slopes of two bodies' volumes point: to the second, and
    away from it. The steeper slope is that of the flatter surface (Nairn 2013 takes the steeper
    one; a mean of equals is less rough). That of a body that never moves is not rough at all.
    """
    a = wp.length_sq(to) * trust(yields[1])
    b = wp.length_sq(away) * trust(yields[0])
    more = type(a)(STEEPER) * (a - b) / wp.max(a + b, type(a)(1e-30))
    share = wp.clamp(type(a)(0.5) + more, type(a)(0.0), type(a)(1.0))
    return wp.normalize(share * to - (type(a)(1.0) - share) * away)


@wp.func
def outward(n: Any):
    """The step to the next node along the axis closest to a normal."""
    axis = steepest(n)
    step = wp.vec3i()
    step[axis] = int(wp.sign(n[axis]))
    return step


@wp.func
def shared_most(
    first: wp.array(dtype=Any),
    first_window: wp.array(dtype=wp.vec3i),
    second: wp.array(dtype=Any),
    second_window: wp.array(dtype=wp.vec3i),
    node: wp.vec3i,
    step: wp.vec3i,
):
    """The node that two bodies share most, of three in a row: the one closest to their surfaces."""
    at = node
    most = mass_at(first, first_window, node) * mass_at(second, second_window, node)
    for side in range(-1, 2, 2):
        here = node + side * step
        shared = mass_at(first, first_window, here) * mass_at(second, second_window, here)
        if shared > most:
            most = shared
            at = here
    return at


@wp.func
def fill_fraction(
    grid: wp.array(dtype=Any),
    window: wp.array(dtype=wp.vec3i),
    node: wp.vec3i,
    inward: wp.vec3i,
    fill: Any,
    narrowest: Any,
):
    """Mass of a body around a node as a fraction of that in its depth, up to two nodes inward; -1
    where it fills less than `narrowest` there.

    At an edge of the body, and where it is compressed, both change alike.
    """
    m = mass_at(grid, window, node)
    deep = wp.max(mass_at(grid, window, node + inward), mass_at(grid, window, node + 2 * inward))
    deep = wp.max(m, deep)
    if fill * deep < narrowest:
        return type(fill)(-1.0)
    return m / deep


@wp.func
def gap(
    first: wp.array(dtype=Any),
    first_window: wp.array(dtype=wp.vec3i),
    second: wp.array(dtype=Any),
    second_window: wp.array(dtype=wp.vec3i),
    at: wp.vec3i,
    step: wp.vec3i,
    fill: Any,
):
    """What two bodies do not fill around a node, as a fraction; 1 where only one of them is."""
    a = fill_fraction(first, first_window, at, -step, fill[0], type(fill[0])(NARROWEST))
    b = fill_fraction(second, second_window, at, step, fill[1], type(fill[1])(NARROWEST))
    unit = type(a)(1.0)
    return wp.where(wp.min(a, b) < type(a)(0.0), unit, unit - a - b)


@wp.func
def neighbour(step: wp.vec3i, n: int):
    """The step to one of the four nodes next to a row along an axis."""
    axis = steepest(wp.vec3(float(step[0]), float(step[1]), float(step[2])))
    to = wp.vec3i()
    to[(axis + 1 + n / 2) % 3] = 1 - 2 * (n % 2)
    return to


@wp.func
def is_closed(gap: Any, more: Any):
    """Return whether contact is closed at a gap whose four neighbours are larger by `more` in sum.

    At the rim of a contact the gap beyond it is a part of what a node sees.
    """
    unit = type(gap)(1.0)
    return gap < unit and gap <= type(gap)(ROUNDING) * wp.max(more, type(gap)(0.0))


@wp.func
def surfaces_meet(
    first: wp.array(dtype=Any),
    first_window: wp.array(dtype=wp.vec3i),
    second: wp.array(dtype=Any),
    second_window: wp.array(dtype=wp.vec3i),
    at: wp.vec3i,
    step: wp.vec3i,
    fill: Any,
):
    """Whether the surfaces of two bodies have met at the node of a row that they share most."""
    here = gap(first, first_window, second, second_window, at, step, fill)
    more = type(here)(0.0)
    for n in range(4):
        to = at + neighbour(step, n)
        at_neighbour = shared_most(first, first_window, second, second_window, to, step)
        there = gap(first, first_window, second, second_window, at_neighbour, step, fill)
        if there < type(here)(1.0):
            more += there - here
    return is_closed(here, more)


@wp.func
def stop(relative: Any, n: Any, friction: Any):
    """The part of a relative velocity that contact takes: all of the approach along the normal n,
    and of the motion across it as much as Coulomb friction can.
    """
    approach = wp.dot(relative, n)
    if approach <= type(approach)(0.0):
        return type(relative)()
    along = relative - approach * n
    return approach * n + coulomb(along, approach, friction) * along


@cache
def make_pair(real: Any):
    """Kernel over nodes that two bodies share: an impulse between them, as large as it is opposite.

    `low` is the first of these nodes on the lattice, `fill` the volume fraction per mass at a node
    of each body, `yields` 1 for a body that gives way and 0 for one that never moves. A sticky pair
    has one velocity wherever both have mass. `sums_out` collects what the first body gives to the
    second: the impulse, and its moment about the origin of the world. Of the nodes around its own a
    thread reads the masses alone, which no thread changes.
    """
    t = types(real)

    @kernel(f"phy124_pair_{real.__name__}", real, seconds=0.5)
    def pair(
        low: wp.vec3i,
        lattice,
        fill: t.vec2,
        yields: t.vec2,
        friction,
        sticky,
        first_window: Box,
        second_window: Box,
        first_out: t.vec4s,
        second_out: t.vec4s,
        sums_out,
    ):
        i, j, k = wp.tid()
        node = low + wp.vec3i(i, j, k)
        a = wp.dot(node - first_window[0], strides(first_window[1]))
        b = wp.dot(node - second_window[0], strides(second_window[1]))
        p = first_out[a]
        q = second_out[b]
        if p[3] <= real(0.0) or q[3] <= real(0.0):
            return
        change = xyz(p) - xyz(q)
        if sticky == 0:
            if wp.min(fill[0] * p[3], fill[1] * q[3]) < real(LIGHTEST):
                return
            to = fill[1] * slope(second_out, second_window, node, t.vec3())
            away = fill[0] * slope(first_out, first_window, node, t.vec3())
            step = outward(normal(to, away, yields))
            at = shared_most(first_out, first_window, second_out, second_window, node, step)
            if not surfaces_meet(
                first_out, first_window, second_out, second_window, at, step, fill
            ):
                return
            to = fill[1] * slope(second_out, second_window, at, t.vec3())
            away = fill[0] * slope(first_out, first_window, at, t.vec3())
            change = stop(change, normal(to, away, yields), friction)
        shared = yields[0] * q[3] + yields[1] * p[3]
        d = (yields[0] * q[3] / shared) * change
        first_out[a] = p - wp.vector(d[0], d[1], d[2], real(0.0))
        d = (yields[1] * p[3] / shared) * change
        second_out[b] = q + wp.vector(d[0], d[1], d[2], real(0.0))
        J = wp.float64(p[3] * (q[3] / shared)) * wide(change)
        add3(sums_out, IMPULSE, J)
        add3(sums_out, MOMENT, wp.cross(wide(place(lattice, node)), J))

    return pair
