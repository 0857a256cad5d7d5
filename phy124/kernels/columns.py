"""Columns: three nodes in a row at a wall, which respond to it together.

Contact is at the wall itself, between the nodes. Along the axis closest to the
wall's normal, the velocity relative to the wall is to be linear in the distance and zero on the
wall: the first node at least half a cell in front of the wall leads, and the two behind it follow
with the ratios g of their distances (quadratic B-splines reproduce linear functions, and reach no
further behind). Momentum is projected onto such velocities, v_1 = sum(g m v) / sum(g^2 m), which
never adds energy and pushes on all three nodes alike; without this a wall is as soft as a layer one
cell thick. (Extended B-splines: Hoellig, Reif, Wipper 2001.) The wall acts once the material has
reached it, as the masses of the nodes on its two sides show: see `coverage`.

Held material ends in the same way at the surface of its region: the nodes inside are held, and the
one next to the surface follows the one in front of it so that the velocity is zero where the region
ends, g = (1, -w0 / w1, 0) with the weights w of the nodes there.

A node by itself responds by `sticky`, `slip` or `separate`; `all_of_it`, `none_of_it` and `coulomb`
are the fraction of the motion along the wall that a column loses.
"""

from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.transfer import spline


@wp.func
def sticky(v: Any, wall: Any, n: Any, friction: Any):
    """The node moves with the wall."""
    return wall


@wp.func
def slip(v: Any, wall: Any, n: Any, friction: Any):
    """No motion through or away from the wall, free motion along it."""
    return v - wp.dot(v - wall, n) * n


@wp.func
def separate(v: Any, wall: Any, n: Any, friction: Any):
    """May leave the wall; Coulomb friction while pressed on it (Stomakhin et al. 2013, sec. 8)."""
    relative = v - wall
    speed = wp.dot(relative, n)
    if speed >= type(speed)(0.0):
        return v
    along = relative - speed * n
    length = wp.length(along)
    if length <= -friction * speed:
        return wall
    return wall + along * (type(speed)(1.0) + friction * speed / length)


@wp.func
def all_of_it(along: Any, pressed: Any, friction: Any):
    """1: a sticky wall takes all of the motion along it."""
    return type(pressed)(1.0)


@wp.func
def none_of_it(along: Any, pressed: Any, friction: Any):
    """0: a wall without friction takes none of the motion along it."""
    return type(pressed)(0.0)


@wp.func
def coulomb(along: Any, pressed: Any, friction: Any):
    """Fraction of the motion along the wall that friction can stop."""
    wanted = wp.length(along)
    if wanted <= friction * pressed:
        return type(pressed)(1.0)
    return friction * pressed / wanted


NARROWING = wp.constant(1.45)
"""Power between the ratios of neighbouring nodes: 1.1 to 1.3 of an edge, 1.2 to 1.6 of a cone."""
OUT_OF_REACH = wp.constant(-1.25)
"""Distance [cells] of a node behind a wall from which on it has nothing of a body in front of it:
the nearest particles are a quarter of a cell away from the wall."""


@wp.func
def coverage(u: Any):
    """Fraction of a quadratic B-spline beyond a plane that is u cells before its centre."""
    unit = type(u)(1.0)
    sixth = type(u)(1.0 / 6.0)
    reach = wp.max(type(u)(1.5) - wp.abs(u), type(u)(0.0))
    tail = sixth * reach * reach * reach
    if u < type(u)(-0.5):
        return tail
    if u > type(u)(0.5):
        return unit - tail
    return type(u)(0.5) + u * (type(u)(0.75) - u * u * type(u)(1.0 / 3.0))


@wp.func
def xyz(q: Any):
    """The first three components: a node's velocity, a distance's normal, or a track's value."""
    return wp.vector(q[0], q[1], q[2])


@wp.func
def relative(q0: Any, q1: Any, q2: Any, wall: Any):
    """The velocities of a column's nodes relative to a wall [node, axis]."""
    return wp.matrix_from_rows(xyz(q0) - wall, xyz(q1) - wall, xyz(q2) - wall)


@wp.func
def narrow(m: Any, farther: Any, u: Any):
    """Factor on the mass expected nearer to a wall, of a body that narrows towards it.

    The body has the mass m on a node u cells in front of the wall, and `farther` on the next one.
    If it were straight, their ratio would be that of `coverage`. Where its cross-section grows with
    a power of the distance, the ratio is smaller by a factor, and the next ratio towards the wall
    by about that factor to the power of `NARROWING`.
    """
    unit = type(u)(1.0)
    return wp.pow(
        wp.min(m * coverage(u + unit) / (farther * coverage(u)), unit), type(u)(NARROWING)
    )


@wp.func
def has_arrived(m: Any, above: Any, beyond: Any, u: Any, lightest: Any, full: Any):
    """Whether material has reached a wall: nodes u cells in front of it have masses m.

    A body that touches the wall covers their splines in a known ratio; with a gap, less is on the
    nearer node. The ratio does not depend on how dense or wide the body is. Irregular particles
    scatter about it, and a body must not stand on the few fullest columns only, so a fraction
    `full` of it is enough. If something heavier lies on it, the farther node counts as at most a
    full node of the `lightest` material.

    Tips, edges and hairs have less on the nearer node although they touch. How they narrow is seen
    one node farther from the wall: with the first two nodes for the one behind it, or with the mass
    `above` the first where a body at the wall does not reach that one. What has mass `beyond` the
    three nodes has got through.
    """
    zero = type(above)(0.0)
    if m[1] <= zero:
        return False
    behind = wp.min(m[0], lightest * coverage(u[0]))
    enough = full * behind * coverage(u[1])
    if m[1] * coverage(u[0]) >= enough:
        return True
    if beyond > zero:
        return True
    if u[2] > type(above)(OUT_OF_REACH):
        return m[2] * coverage(u[1]) >= full * m[1] * coverage(u[2]) * narrow(m[1], m[0], u[1])
    return above > zero and m[1] * coverage(u[0]) >= enough * narrow(m[0], above, u[0])


@wp.func
def has_mass(m: Any, above: Any, beyond: Any, u: Any, lightest: Any, full: Any):
    """Whether the node next to the surface of a region that holds has mass."""
    return not m[1] <= type(above)(0.0)


@wp.func
def linear(distances: Any, across: Any):
    """Ratios g of a velocity that is linear in the distance and zero on the wall."""
    return distances / distances[0]


@wp.func
def ending(distances: Any, across: Any):
    """Ratios g of a velocity that is zero where the region ends; `across` is the cell size [m]."""
    unit = type(across)(1.0)
    w = spline(distances[0] / across)
    return wp.vector(unit, -w[0] / w[1], type(across)(0.0))


@wp.func
def tie(v: Any, m: Any, g: Any):
    """Change of the velocities [node, axis] of masses m that makes them follow with ratios g."""
    weight = wp.cw_mul(g, m)
    return wp.outer(g, (wp.transpose(v) @ weight) / wp.dot(weight, g)) - v


@wp.func
def hold_back(behind: Any, front: Any, normal: Any):
    """Change of a velocity behind a wall that goes into it faster than one in front of it does.

    It only makes the motion slower, so it never adds energy.
    """
    zero = type(normal[0])(0.0)
    fastest = wp.min(wp.dot(front, normal), zero)
    return wp.max(fastest - wp.dot(behind, normal), zero) * normal


@wp.func
def along_wall(change: Any, normal: Any):
    """The part of changes [node, axis] that is along a wall."""
    return change - wp.outer(change * normal, normal)


@wp.func
def pressing(pressed: Any):
    """Whether the wall pushes: it lets go of material that leaves."""
    return pressed > type(pressed)(0.0)


@wp.func
def either_way(pressed: Any):
    """Always true: the wall does not let go of material that leaves."""
    return True


@wp.func
def add_rows(nodes: wp.array(dtype=Any), first: int, step: int, m: Any, change: Any, fourth: Any):
    """Add changes of velocity [node, axis], and a number, to a column's nodes with mass."""
    for row in range(3):
        if m[row] > type(m[row])(0.0):
            nodes[first + row * step] += wp.vector(
                change[row, 0], change[row, 1], change[row, 2], fourth
            )


class Response(NamedTuple):
    """How nodes respond to a wall: one by one, or as a column of three."""

    answer: Any
    """`(v, wall, n, friction) -> v` of a node by itself."""
    acts: Any
    """`(m, above, beyond, u, lightest, full)`: whether the wall acts on a column yet."""
    ratios: Any
    """`(distances, across) -> g`, how the velocities of a column follow the first."""
    pushes: Any
    """`(pressed)`: whether it acts, by the impulse per mass along its normal."""
    hold: Any
    """`(along, pressed, friction)`: the fraction of the motion along the wall that it takes."""


RESPONSES = {
    "sticky": Response(sticky, has_arrived, linear, either_way, all_of_it),
    "slip": Response(slip, has_arrived, linear, either_way, none_of_it),
    "separate": Response(separate, has_arrived, linear, pressing, coulomb),
    "held": Response(sticky, has_mass, ending, either_way, all_of_it),
}
