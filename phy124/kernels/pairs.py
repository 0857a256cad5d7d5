"""Contact between two bodies: their velocities are made equal at nodes at which both have mass.

Each body has a separate velocity field. Impulses act between two bodies at the nodes that belong to
both (Bardenhagen, Brackbill and Sulsky 2000; Bardenhagen et al. 2001). The normal of an impulse is
computed from the gradients of both bodies' volumes (Nairn 2013), so both have the same normal.

Two bodies have common nodes before they touch, so contact needs another criterion. The weights of a
quadratic B-spline have the variance dx^2 / 4 along every direction. The volume fraction of a body
around a node therefore determines how far the body's surface is from the node, whatever the
direction. Two surfaces meet if the fractions add up to 1. (Nairn et al. 2020 compute the distance
by a regression over the particles.) The fraction is the ratio of the body's mass at the node to its
mass in the interior; this accounts for the body's edges, density and compression. Three nodes in a
row, along the axis closest to the normal, are either all in contact, or none of them is. The node
with the largest overlap of both bodies decides for all three. At the rim of a contact, where the
gap is curved, the mean of the gap around a node is larger than the gap at the node.
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
"""Contact of two bodies is possible at a node only if both bodies have at least this volume
fraction there.
"""
NARROWEST = wp.constant(0.05)
"""Smallest volume fraction around a node that counts as a body's interior. The volume fraction is
1/2 at an edge of a body and 1/4 at a corner. The volume fraction is smaller outside a body or
around a single particle.
"""
ROUNDING = wp.constant(0.375)
"""Contact tolerance for curved gaps between two bodies. The gap at a node counts as closed if it is
at most this fraction of a sum: the gaps at the four neighbouring nodes, each minus the gap at the
node. The curvature of a gap between two splines would give a tolerance of 1/4. The larger tolerance
that is used is fitted to measurements with balls (docs/lab/contact-force.md).
"""
STEEPER = wp.constant(10.0)
"""Weight that determines how close the contact normal of two bodies is to the steeper of the slopes
of their volumes. With the weight 0, the normal would have the direction of the mean of both slopes.
The larger the weight, the closer the normal is to the steeper slope.
"""
TRUSTED = wp.constant(4.0)
"""Factor on the squared slope of a body that never moves, in the contact normal of two bodies."""


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

    The gradient along each axis is a mean of nine differences. With a single difference, a surface
    roughness of a hundredth of a cell would brake sliding objects.
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
    """Return the weight of a body's slope in the contact normal, which is larger for a
    fixed body.
    """
    return type(yields)(TRUSTED) - (type(yields)(TRUSTED) - type(yields)(1.0)) * yields


@wp.func
def normal(to: Any, away: Any, yields: Any):
    """Return the normal of the contact of two bodies at a node, from the slopes of their volumes.

    `to` is the slope of the second body's volume, and `away` is the slope of the first body's
    volume. The steeper slope belongs to the flatter surface and has the larger weight. (Nairn 2013
    uses only the steeper slope; the mean of two equal slopes is smoother.) The slope of a body that
    never moves is smooth and gets a larger weight (`trust`).
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

    The interior is searched up to two nodes further inside. The ratio is -1 if the body's volume
    fraction in the interior is less than `narrowest`. At an edge of the body, and under
    compression, both masses change by the same factor.
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
    """Return the fraction of the volume around a node that is empty, between two bodies.

    The fraction is 1 if one of the bodies is absent there.
    """
    a = fill_fraction(first, first_window, at, -step, fill[0], type(fill[0])(NARROWEST))
    b = fill_fraction(second, second_window, at, step, fill[1], type(fill[1])(NARROWEST))
    unit = type(a)(1.0)
    return wp.where(wp.min(a, b) < type(a)(0.0), unit, unit - a - b)


@wp.func
def neighbour(step: wp.vec3i, n: int):
    """Return the step to one of the four neighbours of a node that lie perpendicular to `step`."""
    axis = steepest(wp.vec3(float(step[0]), float(step[1]), float(step[2])))
    to = wp.vec3i()
    to[(axis + 1 + n / 2) % 3] = 1 - 2 * (n % 2)
    return to


@wp.func
def is_closed(gap: Any, more: Any):
    """Return whether the gap between two bodies at a node counts as closed.

    The gap is averaged over more than one cell. At the edge of the contact area, the mean includes
    the wider gap outside this area. A gap up to `ROUNDING` times `more` therefore counts as closed.
    Here `more` is the sum of the neighbours' gaps, each minus the node's gap.
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
    """Return whether the surfaces of two bodies meet at the node at which the bodies
    overlap most.
    """
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
    """Return the component of the relative velocity of two bodies that their contact removes.

    Contact removes the whole approaching velocity along the normal n, and the tangential velocity
    as far as Coulomb friction allows.
    """
    approach = wp.dot(relative, n)
    if approach <= type(approach)(0.0):
        return type(relative)()
    along = relative - approach * n
    return approach * n + coulomb(along, approach, friction) * along


@build_once
def make_pair(real: Any):
    """Kernel over the common nodes of two bodies: applies equal and opposite impulses to them.

    `low` is the first of the common nodes. `fill` contains a factor for each body, by which a mass
    is multiplied to get a volume fraction. `yields` is 1 for a body that can move and 0 for a body
    that never moves. A sticky pair has one velocity at each node at which both bodies have mass.
    `sums_out` sums the impulses of the first body on the second, and their moments about the origin
    of the world. A thread reads only the masses of neighbouring nodes, which no thread changes.
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
