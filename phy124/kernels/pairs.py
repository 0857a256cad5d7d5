"""Contact between two bodies: at nodes at which both bodies have mass, the velocities are made
equal.

Each body has a separate velocity field (Bardenhagen, Brackbill and Sulsky 2000; Bardenhagen et al.
2001). The normal follows from the gradients of both volumes (Nairn 2013). Two surfaces meet if the
bodies' volume fractions around a node add up to 1. Three nodes in a row are either all in contact,
or none of them is. docs/design/contact.md explains the method.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.collide import steepest
from phy124.kernels.columns import coulomb, xyz
from phy124.kernels.contacts import IMPULSE, MOMENT
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.window import place, strides

LIGHTEST = wp.constant(1e-6)
"""Smallest volume fraction of both bodies at a node at which contact is possible."""
NARROWEST = wp.constant(0.05)
"""Smallest volume fraction around a node that counts as a body's interior. The volume fraction is
1/2 at an edge of a body and 1/4 at a corner.
"""
ROUNDING = wp.constant(0.375)
"""A gap at a node counts as closed up to this fraction of a sum over four neighbours: each
neighbour's gap, minus the node's gap. The curvature of a gap between two splines would give 1/4;
the value is fitted to measurements with balls (docs/lab/contact-force.md).
"""
STEEPER = wp.constant(10.0)
"""Weight of the steeper of two slopes in the contact normal; 0: the mean of both slopes."""
TRUSTED = wp.constant(4.0)
"""Factor on the squared slope of a body that never moves, in the contact normal."""


@wp.func
def mass_at(grid: wp.array(dtype=Any), window: wp.array(dtype=wp.vec3i), node: wp.vec3i):
    """Return a body's mass at a node of the lattice [kg]; zero outside the body's window."""
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
    """Return `zero` plus the gradient of a body's mass at a node [kg per 32 cells].

    With a single difference instead of nine, a surface roughness of a hundredth of a cell would
    brake sliding objects.
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
    """Return the weight that the slope of a body's volume has in the contact normal."""
    return type(yields)(TRUSTED) - (type(yields)(TRUSTED) - type(yields)(1.0)) * yields


@wp.func
def normal(to: Any, away: Any, yields: Any):
    """Return the normal of the contact of two bodies, from the slopes of their volumes.

    `to` is the slope of the second body's volume, and `away` the slope of the first body's volume.
    The steeper slope belongs to the flatter surface and has the larger weight. (Nairn 2013 uses
    only the steeper slope.)
    """
    a = wp.length_sq(to) * trust(yields[1])
    b = wp.length_sq(away) * trust(yields[0])
    more = type(a)(STEEPER) * (a - b) / wp.max(a + b, type(a)(1e-30))
    share = wp.clamp(type(a)(0.5) + more, type(a)(0.0), type(a)(1.0))
    return wp.normalize(share * to - (type(a)(1.0) - share) * away)


@wp.func
def outward(n: Any):
    """Return the step to the next node along the axis that is closest to a contact normal."""
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
    """Return the node, of three in a row, at which two bodies overlap most."""
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
    """Return a body's mass at a node, divided by its mass at nodes in its interior.

    The interior is searched at nodes up to two steps further inside the body. The result is -1 if
    the volume fraction there is less than `narrowest`. Edges and compression change both masses by
    the same factor.
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
    """Return the empty fraction of the volume around a node; 1 if one of the bodies is absent."""
    a = fill_fraction(first, first_window, at, -step, fill[0], type(fill[0])(NARROWEST))
    b = fill_fraction(second, second_window, at, step, fill[1], type(fill[1])(NARROWEST))
    unit = type(a)(1.0)
    return wp.where(wp.min(a, b) < type(a)(0.0), unit, unit - a - b)


@wp.func
def neighbour(step: wp.vec3i, n: int):
    """Return the step to one of the four neighbours of a node perpendicular to `step`."""
    axis = steepest(wp.vec3(float(step[0]), float(step[1]), float(step[2])))
    to = wp.vec3i()
    to[(axis + 1 + n / 2) % 3] = 1 - 2 * (n % 2)
    return to


@wp.func
def is_closed(gap: Any, more: Any):
    """Return whether the gap between two bodies at a node counts as closed.

    `more` is the sum of the neighbours' gaps, each minus the node's gap. At the edge of the contact
    area, the mean gap around a node includes the wider gap outside this area.
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
    """Return whether two surfaces meet at the node at which the bodies overlap most."""
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
    """Return the part of two bodies' relative velocity that contact with friction removes."""
    approach = wp.dot(relative, n)
    if approach <= type(approach)(0.0):
        return type(relative)()
    along = relative - approach * n
    return approach * n + coulomb(along, approach, friction) * along


@build_once
def make_pair(real: Any):
    """Kernel over the common nodes of two bodies: applies equal and opposite impulses to them.

    `low` is the first common node. `fill` is the volume fraction per mass of each body. `yields` is
    1 for a body that can move and 0 for a body that never moves. The bodies of a sticky pair have
    the same velocity at each node at which both have mass. `sums_out` sums the impulses of the
    first body on the second, and their moments about the origin of the world.
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
